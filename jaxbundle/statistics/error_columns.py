"""Effects of errors of observations as columns, and their tests by the residuals.

A column of B is minus the effect of a unit error on the residuals: 1 for an observed value. The effect of an image
point includes its corrections, if the measurement is corrected and not the projection. An error in a fixed coordinate
affects all observations of its point: its column is minus that of the design matrix. With C = P^1/2 B and the weighted
    residuals v,

    g = C^T v,    M = C^T C - (A^T C)^T N^-1 (A^T C) = B^T P Q_vv P B

are sufficient for tests of any combination of the columns (Baarda 1968, Foerstner 1983, Teunissen 2000): the estimated
size of the error is -M^-1 g, and g^T M^-1 g is the decrease of v^T P v if it is removed. N^-1 comes from one
factorisation for all columns. M does not depend on the datum.

The residuals of an adjustment are orthogonal to A. Residuals at other values of the unknowns are not; then the
part that a step of Gauss-Newton would explain is subtracted: v becomes an additional column.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.design import Corrections, design_columns, free_elements, no_corrections, residuals_after
from jaxbundle.block.residuals import Observations, observations_of, ray_residuals
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors, problem, to_elimination_order
from jaxbundle.normals.plan.known_plans import planned
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.normals.solve_normals import inverse_products
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION, Compiled
from jaxbundle.numerics.host import tree_with
from jaxbundle.numerics.shapes import grid_size

MAX_DENSE = 1500  # unknowns: up to this number the full design matrix is faster than a solution for each column
DETERMINED = 1e-11  # diagonal of R, for columns of A of length 1: smaller ones are rounding
FIXED = -1  # table of a fixed coordinate, which is not observed


class ErrorColumn(NamedTuple):
    """A column of a unit error: `values` are added to components of members of a table, in the frame of its residuals.

    Tables are numbered like those of the residuals; FIXED is the table of the object points with components X, Y, Z.
    """

    table: int
    member: Int[np.ndarray, " entry"]
    component: Int[np.ndarray, " entry"]
    values: Float[np.ndarray, " entry"]


class ErrorTests(NamedTuple):
    """g and M of all columns, the diagonal of C^T C, v^T P v and the redundancy."""

    right: Float[np.ndarray, " column"]
    matrix: Float[np.ndarray, "column column"]
    lengths: Float[np.ndarray, " column"]
    vtpv: float
    redundancy: int

    def combined(self, combinations: sp.csc_matrix) -> "ErrorTests":
        """The tests of combinations of the columns, which are the columns of a matrix."""
        both = combinations.T @ (combinations.T @ self.matrix).T
        lengths = np.asarray(combinations.multiply(combinations).T @ self.lengths).ravel()
        return self._replace(right=combinations.T @ self.right, matrix=both, lengths=lengths)


def error_tests(block: Block, residuals: Sequence[np.ndarray], columns: Sequence[ErrorColumn]) -> ErrorTests:
    """Computes g and M at the values of a block; `residuals`: tables of the weighted residuals at these values.

    A large block must be adjusted.
    """
    block = with_datum(block)
    centres = np.asarray(block.exterior.projection_centre)
    centred = block.moved(-centres.mean(0))
    unknowns, observations = unknowns_of(centred), observations_of(centred)
    c = _weighted_columns(block, columns, unknowns, observations)
    v = np.concatenate([np.asarray(table).ravel() for table in residuals])
    gram, right, vtpv = (c.T @ c).toarray(), c.T @ v, float(v @ v)
    lengths = np.diagonal(gram).copy()
    if block.structure.n_unknowns > MAX_DENSE:
        explained = _explained_by_elimination(block, centred, unknowns, _transposed_products(unknowns, observations, c))
    else:
        explained, by_step, gain = _explained_densely(unknowns, observations, c, v)
        right, vtpv = right - by_step, vtpv - gain
    return ErrorTests(right, gram - explained, lengths, vtpv, block.redundancy)


def _explained_densely(
    unknowns: Unknowns, o: Observations, c: sp.csc_matrix, v: Float[np.ndarray, " observation"]
) -> tuple[Float[np.ndarray, "column column"], Float[np.ndarray, " column"], float]:
    """The products (A^T C)^T N^-1 (A^T C), also with A^T v on one and both sides, by the full design matrix."""
    free = free_elements(o)
    a = np.asarray(_design(unknowns, o, free.chunks.astype(np.int32), optimised=False))[: free.number]
    a = a / np.linalg.norm(a, axis=1)[:, None]
    # by an orthogonal basis: for hardly determined unknowns the normal equations have no factor
    orthogonal, factor = np.linalg.qr(a.T)
    good = np.abs(np.diagonal(factor)) > DETERMINED
    half = np.where(good[:, None], np.concatenate([c.T @ orthogonal, (v @ orthogonal)[None]]).T, 0.0)
    products = half.T @ half
    return products[:-1, :-1], products[:-1, -1], float(products[-1, -1])


@Compiled
def _design(
    unknowns: Unknowns, o: Observations, free: Int[Array, "chunk at_once"]
) -> Float[Array, "column observation"]:
    return design_columns(unknowns, o, free)


def _explained_by_elimination(
    block: Block, centred: Block, unknowns: Unknowns, products: tuple[np.ndarray, ...]
) -> Float[np.ndarray, "column column"]:
    """The product (A^T C)^T N^-1 (A^T C) by the elimination of the points."""
    centres = np.asarray(block.exterior.projection_centre)
    plan = planned(block.structure, block.groups, centres, 1)
    padded = [np.pad(x, [(0, grid_size(len(x)) - len(x)), *[(0, 0)] * (x.ndim - 1)]) for x in products]
    rows = ordered_vectors(plan, block.structure, BlockVectors(*padded))
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    found = _explained(to_elimination_order(plan, unknowns), problem(plan, centred), rows, optimised=optimised)
    count = len(products[0])
    return np.asarray(found)[:count, :count]


@Compiled
def _explained(unknowns: OrderedUnknowns, p: Problem, rows: NormalVector) -> Float[Array, "column column"]:
    """(A^T C)^T N^-1 (A^T C)."""
    return inverse_products(unknowns, p, rows)


def _weighted_columns(
    block: Block, columns: Sequence[ErrorColumn], unknowns: Unknowns, o: Observations
) -> sp.csc_matrix:
    """C."""
    sizes = [2 * len(block.structure.ray_image), *(group.structure.observed.size for group in block.groups)]
    start = np.concatenate([[0], np.cumsum(sizes)])
    weights = 1 / np.asarray(block.rays.sigmas), *(np.asarray(group.weights) for group in block.groups)
    fixed = image_points = None
    entries = []
    for column in columns:
        if column.table == FIXED:
            fixed = _fixed_effects(block, unknowns, o) if fixed is None else fixed
            entries.append(fixed.of(column))
        elif column.table == 0:
            image_points = _image_point_effects(block, unknowns, o) if image_points is None else image_points
            entries.append(image_points.of(column))
        else:
            entries.append(_observed_effects(column, weights[column.table], int(start[column.table])))
    rows, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    ends = np.concatenate([[0], np.cumsum([len(part[0]) for part in entries])])
    return sp.csc_matrix((values, rows, ends), (start[-1], len(columns)))


def _observed_effects(column: ErrorColumn, weights: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Observations and their changes over the sigmas; `first`: number of the table's first observation."""
    width = weights.shape[1]
    if weights.ndim == 2:
        rows = first + width * column.member + column.component
        return rows, weights[column.member, column.component] * column.values
    rows = first + width * column.member[:, None] + np.arange(width)  # correlated components: columns of L^-1
    return rows.ravel(), (weights[column.member, :, column.component] * column.values[:, None]).ravel()


class _ImagePointEffects(NamedTuple):
    """Minus the changes of the weighted residuals of the rays for a unit error of x and of y, y up."""

    changes: Float[np.ndarray, "2 2 ray"]

    def of(self, column: ErrorColumn) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of both residuals of each ray: for a corrected image point each depends on both coordinates."""
        rows = 2 * column.member[:, None] + np.arange(2)
        values = column.values[:, None] * self.changes[column.component, :, column.member]
        return rows.ravel(), values.ravel()


def _image_point_effects(block: Block, unknowns: Unknowns, o: Observations) -> _ImagePointEffects:
    s = block.structure
    down = s.rays_downward
    upward = np.stack([np.ones(len(down)), np.where(down, -1.0, 1.0)])
    optimised = len(s.ray_image) >= RAYS_FOR_OPTIMISATION
    return _ImagePointEffects(-np.asarray(_changes_by_image_points(unknowns, o, upward, optimised=optimised)))


@Compiled
def _changes_by_image_points(unknowns: Unknowns, o: Observations, upward: Array) -> Float[Array, "2 2 ray"]:
    """Changes of the weighted residuals for a unit shift of all image points along x and along y."""

    def residuals(coordinates: Float[Array, "2 ray"]) -> Float[Array, "2 ray"]:
        return ray_residuals(unknowns, eqx.tree_at(lambda x: x.coordinates, o, coordinates)) * o.weights

    def along(axis: Array) -> Float[Array, "2 ray"]:
        return jax.jvp(residuals, (o.coordinates,), (axis[:, None] * upward,))[1]

    return jax.lax.map(along, jnp.eye(2))


class _FixedEffects(NamedTuple):
    """Changes of all weighted residuals for a unit shift of all fixed points along each axis, and their points."""

    changes: Float[np.ndarray, "3 observation"]
    point: Int[np.ndarray, " observation"]

    def of(self, column: ErrorColumn) -> tuple[np.ndarray, np.ndarray]:
        """Minus the columns of A: the point is at the intersection of its rays, its given coordinates are wrong."""
        rows = [np.flatnonzero(self.point == point) for point in column.member]
        values = [
            -value * self.changes[axis, of_point]
            for of_point, axis, value in zip(rows, column.component, column.values, strict=True)
        ]
        return np.concatenate(rows), np.concatenate(values)


def _fixed_effects(block: Block, unknowns: Unknowns, o: Observations) -> _FixedEffects:
    """Changes for all points with a fixed coordinate; an observation between two of them belongs to none."""
    s = block.structure
    fixed = np.any(~s.point_free, axis=1)
    owners = [np.repeat(np.where(fixed[s.ray_point], s.ray_point, -1), 2)]
    for group in block.groups:
        g = group.structure
        touched = [g.indices[:, k] for k, kind in enumerate(g.kind.touches) if kind == "point"]
        owner = np.full(len(g.indices), -1)
        if touched:
            points = np.where(fixed[touched], touched, -1)
            owner = np.where((points >= 0).sum(0) == 1, points.max(0), -1)
        owners.append(np.repeat(owner, g.observed.shape[1]))
    optimised = len(s.ray_image) >= RAYS_FOR_OPTIMISATION
    changes = _changes_by_points(unknowns, o, fixed, optimised=optimised)
    return _FixedEffects(np.asarray(changes), np.concatenate(owners))


@Compiled
def _changes_by_points(unknowns: Unknowns, o: Observations, moved: Array) -> Float[Array, "3 observation"]:
    """Changes of the weighted residuals for a unit shift of the points `moved` along X, Y and Z."""
    zero, residuals = no_corrections(o), residuals_after(unknowns, o)

    def along(axis: Array) -> Float[Array, " observation"]:
        return jax.jvp(residuals, (zero,), (zero._replace(points=jnp.where(moved[None], axis[:, None], 0.0)),))[1]

    return jax.lax.map(along, jnp.eye(3))


def _transposed_products(
    unknowns: Unknowns, o: Observations, c: sp.csc_matrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Computes A^T C, vectors first: exterior by image, interior by camera, parameters, points.

    Rays without a non-zero element in any column are left out.
    """
    rays = len(o.ray_image)
    touched = np.unique(c.indices[c.indices < 2 * rays] // 2)
    chosen = np.zeros(grid_size(len(touched)), np.int32)
    chosen[: len(touched)] = touched
    used = np.arange(len(chosen)) < len(touched)
    few = tree_with(
        lambda x: (x.ray_image, x.ray_point, x.coordinates, x.weights),
        o,
        (
            np.asarray(o.ray_image)[chosen],
            np.asarray(o.ray_point)[chosen],
            np.asarray(o.coordinates)[:, chosen],
            np.asarray(o.weights)[:, chosen] * used,
        ),
    )
    observations, count = c.get_shape()
    rows = np.concatenate([(2 * touched[:, None] + np.arange(2)).ravel(), np.arange(2 * rays, observations)])
    columns = np.zeros((grid_size(count), 2 * len(chosen) + observations - 2 * rays))
    kept = np.asarray(c.tocsr()[rows].todense()).T
    columns[:count, : 2 * len(touched)] = kept[:, : 2 * len(touched)]
    columns[:count, 2 * len(chosen) :] = kept[:, 2 * len(touched) :]
    found = _transposed(unknowns, few, columns, optimised=rays >= RAYS_FOR_OPTIMISATION)
    exterior, interior, parameters, points = (np.asarray(part)[:count] for part in found)
    return exterior.transpose(0, 2, 1), interior.transpose(0, 2, 1), parameters, points.transpose(0, 2, 1)


@Compiled
def _transposed(unknowns: Unknowns, o: Observations, columns: Float[Array, "column observation"]) -> Corrections:
    """Computes A^T c for each column c."""
    _, transposed = jax.vjp(residuals_after(unknowns, o), no_corrections(o))
    return jax.lax.map(lambda column: transposed(column)[0], columns)
