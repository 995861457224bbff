"""Precision of functions of the unknowns, error ellipses, and precision by groups.

    C_ff = sigma0^2 F Q F^T,    F = df/d(unknowns) by autodiff

Q F^T comes from the factorised normal equations, with one pass through the tiles per function; Q is not formed.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.unknowns import angle_derivatives, unknowns_of
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors, problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.plan.known_plans import planned
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.normals.solve_normals import inverse_products
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION, Compiled
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.numerics.trial import first_line
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.free_network import carrying_places, with_inner_constraints

EXAMPLE = "for example jb.covariance_of(result, lambda block: block.object_points[jnp.array([3, 7])])"


class Estimated(NamedTuple):
    """Values of functions of the unknowns, their a-posteriori covariance matrix and standard deviations.

    Functions may have any shape: the covariance of elements [i, j] and [k, l] has the index [i, j, k, l].
    """

    values: Float[np.ndarray, "*shape"]
    covariance: Float[np.ndarray, "..."]

    @property
    def standard_deviations(self) -> Float[np.ndarray, "*shape"]:
        """Standard deviations: square roots of the variances."""
        count, shape = self.values.size, self.values.shape
        return np.sqrt(np.diagonal(self.covariance.reshape(count, count))).reshape(shape)


class Ellipsoids(NamedTuple):
    """Semi-axes of standard ellipses or ellipsoids, longest first, and their directions, which are the columns."""

    semi_axes: Float[np.ndarray, "point axis"]
    directions: Float[np.ndarray, "point coordinate axis"]


def covariance_of(adjustment: Adjustment, function: Callable[[Block], Array]) -> Estimated:
    """Values and covariance of a differentiable function of the adjusted block: one number or an array of any shape.

    `lambda b: b.object_points[jnp.array([3, 7])]` gives values (2, 3) and a covariance (2, 3, 2, 3). Fixed values of
    the block have no errors. A robust adjustment uses the weights of its last round.

    Raises: TypeError for a function that does not return an array of numbers; ValueError for a function that is not
    differentiable or has values or derivatives that are not finite, and for a solution by conjugate gradients.

    Example:
        >>> found = jb.covariance_of(result, lambda b: jnp.linalg.norm(b.object_points[0] - b.object_points[1]))
        >>> found.values.shape, bool(found.standard_deviations > 0)
        ((), True)
    """
    require_a(Adjustment, adjustment, "covariance_of")
    if adjustment.reduced == "pcg":
        raise ValueError("conjugate gradients give no variances: adjust with another solver")
    adjusted = adjustment.weighted_block
    values, derivatives = _linearised(adjusted, function)
    block = with_datum(adjusted)
    centres = np.asarray(block.exterior.projection_centre)
    centred = block.moved(-centres.mean(0))
    plan = planned(block.structure, block.groups, centres, 1)
    args = to_elimination_order(plan, unknowns_of(centred)), problem(plan, centred)
    rows = _arranged_rows(plan, block, derivatives)
    inner = block.structure.datum.constraints
    carrying = carrying_places(block.structure, plan) if inner else None
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    cofactors = np.asarray(_cofactors(*args, rows, carrying, inner, optimised=optimised))
    covariance = float(adjustment.sigma0) ** 2 * cofactors
    return Estimated(values, covariance.reshape(values.shape * 2))


class _Rows(NamedTuple):
    """Derivatives of a function with respect to the unknowns of a block, one row for each of its values."""

    centre: Float[np.ndarray, "function image 3"]
    angles: Float[np.ndarray, "function image 3"]
    interior: Float[np.ndarray, "function camera element"]
    points: Float[np.ndarray, "function point 3"]
    parameters: Float[np.ndarray, "function parameter"]


def _unknown_values(block: Block) -> tuple:
    exterior = block.exterior
    elements = block.interior.elements
    return exterior.projection_centre, exterior.angles, elements, block.object_points, block.parameters


def _linearised(block: Block, function: Callable[[Block], Array]) -> tuple[Float[np.ndarray, "*shape"], _Rows]:
    """A user's function at the adjusted block: its values, and its derivatives, one row for each value."""
    if not callable(function):
        raise TypeError(f"covariance_of needs a function of the block, not {type(function).__name__}: {EXAMPLE}")

    def vector(values: tuple) -> Float[Array, " function"]:
        return jnp.ravel(jnp.asarray(function(eqx.tree_at(_unknown_values, block, values))))

    try:
        returned = function(block)
    except Exception as error:  # code of the user: any exception is its error
        raise ValueError(f"the function fails with {type(error).__name__}: {first_line(error)}; {EXAMPLE}") from error
    if not (hasattr(returned, "dtype") or isinstance(returned, float | int)):
        raise TypeError(f"the function returns {type(returned).__name__}, not an array of numbers; {EXAMPLE}")
    values = np.asarray(returned)
    if not np.issubdtype(values.dtype, np.floating):
        raise TypeError(f"the function returns an array of {values.dtype}, not of floating-point numbers; {EXAMPLE}")
    if values.size == 0:
        raise ValueError(f"the function returns an array without elements, of shape {values.shape}; {EXAMPLE}")
    if not np.isfinite(values).all():
        raise ValueError(f"{_share(values)} values of the function are not finite numbers; guard its divisions")
    try:
        derivatives = _Rows(*map(np.asarray, jax.jacrev(vector)(_unknown_values(block))))
    except Exception as error:
        raise ValueError(
            f"the function cannot be differentiated ({type(error).__name__}: {first_line(error)}); write it with"
            f" jax.numpy: {EXAMPLE}"
        ) from error
    names = "projection centres", "angles", "interior", "object_points", "parameters"
    for name, rows in zip(names, derivatives, strict=True):
        if not np.isfinite(rows).all():
            raise ValueError(
                f"{_share(rows)} derivatives of the function with respect to the {name} are not finite numbers;"
                " guard roots of 0 and divisions by jnp.where"
            )
    return values, derivatives


def _share(values: np.ndarray) -> str:
    return f"{int((~np.isfinite(values)).sum())} of {values.size}"


@Compiled
def _cofactors(
    unknowns: OrderedUnknowns, p: Problem, rows: NormalVector, carrying: Float[Array, " place"] | None, constraints: int
) -> Float[Array, "function function"]:
    """F Q F^T."""
    if carrying is not None:
        rows = with_inner_constraints(unknowns, p, carrying, constraints, rows)
    return inverse_products(unknowns, p, rows)


def _arranged_rows(plan: EliminationPlan, block: Block, derivatives: _Rows) -> NormalVector:
    """The matrix F in elimination order, with respect to the angles of the corrections."""
    structure, turned = block.structure, _angles_by_corrections(block)
    by_angles = np.einsum("fia,abi->fib", derivatives.angles, turned)
    rows = BlockVectors(
        np.concatenate([derivatives.centre, by_angles], 2),
        derivatives.interior[:, :, list(structure.interior_columns)],
        derivatives.parameters,
        derivatives.points,
    )
    return ordered_vectors(plan, structure, rows)


def _angles_by_corrections(block: Block) -> Float[np.ndarray, "3 3 image"]:
    """Derivatives of the user's angles with respect to those of the corrections."""
    angles, system = np.asarray(block.exterior.angles).T, block.structure.rotation_system
    images = angles.shape[1]
    matrix = np.repeat(np.eye(3).reshape(9, 1), grid_size(images), 1)
    reference = np.zeros((3, matrix.shape[1]))
    matrix[:, :images], reference[:, :images] = unknowns_of(block).rotation, angles
    turned = _compiled_angle_derivatives(matrix, reference, system, optimised=False)
    return np.asarray(turned)[..., :images]


@Compiled
def _compiled_angle_derivatives(
    matrix: Float[Array, "9 image"], reference: Float[Array, "3 image"], system: RotationSystem
) -> Float[Array, "3 3 image"]:
    return angle_derivatives(matrix, None, reference, system)


def error_ellipsoids(adjustment: Adjustment) -> Ellipsoids:
    """A-posteriori standard error ellipsoids of all object points.

    Raises: ValueError if no cofactors were computed.

    Example:
        >>> ellipsoids = jb.statistics.error_ellipsoids(result)
        >>> ellipsoids.semi_axes.shape
        (8, 3)
    """
    return _ellipsoids(adjustment, "statistics.error_ellipsoids", 3)


def error_ellipses(adjustment: Adjustment) -> Ellipsoids:
    """A-posteriori standard error ellipses in the plane X, Y of all object points.

    Raises: ValueError if no cofactors were computed.

    Example:
        >>> ellipses = jb.statistics.error_ellipses(result)
        >>> ellipses.semi_axes.shape
        (8, 2)
    """
    return _ellipsoids(adjustment, "statistics.error_ellipses", 2)


def _ellipsoids(adjustment: Adjustment, caller: str, axes: int) -> Ellipsoids:
    """Ellipsoids of the first coordinates of all object points."""
    require_a(Adjustment, adjustment, caller)
    if adjustment.cofactors is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    values, vectors = np.linalg.eigh(np.asarray(adjustment.cofactors.object_points)[:, :axes, :axes])
    roots = float(adjustment.sigma0) * np.sqrt(np.maximum(values, 0.0))
    return Ellipsoids(roots[:, ::-1], vectors[:, :, ::-1])
