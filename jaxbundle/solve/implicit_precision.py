"""Derivatives of cofactors and leverages with respect to all input values.

The engine computes cofactors without the full matrix Q; their derivatives are computed from the full matrix,

    N = A^T A,    Q = N^-1,    h = diag(A Q A^T)        A: derivatives of the weighted residuals by autodiff, with
    respect to free unknowns

in a form without loops, which has forward and transposed derivatives of any order, for at most MAX_UNKNOWNS unknowns.
Larger blocks have derivatives of first order: forward through the engine, transposed by `cofactor_gradient`. Second
    derivatives raise an error.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, Shaped

from jaxbundle.block.block import Structure
from jaxbundle.block.design import MAX_UNKNOWNS
from jaxbundle.normals.cofactor_gradient import CofactorWeights, cofactor_gradient
from jaxbundle.normals.cofactors import Cofactors, cofactors
from jaxbundle.normals.cost import weighted_residuals
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.devices import copied
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.linear_map import linear_map
from jaxbundle.solve.implicit import moved, zero_vector

SECOND = (
    f"standard deviations and redundancy numbers of more than {MAX_UNKNOWNS} unknowns have no second derivatives: call"
    " adjust(..., precision=False) for those of coordinates, orientations and sigma0, or adjust a smaller part of the"
    " block"
)


class Precision(NamedTuple):
    """The fields of `Cofactors` that have derivatives."""

    images: Float[Array, "image d d"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    leverages: list[Array]


def with_derivatives(
    found: Cofactors, x: OrderedUnknowns, p: Problem, plan: EliminationPlan, structure: Structure, optimised: bool
) -> Cofactors:
    """The cofactors as functions of the unknowns and of the observations."""
    free = free_places(plan, structure) if structure.n_unknowns <= MAX_UNKNOWNS else None
    given = Precision(found.images, found.border, found.points, found.leverages)
    q = _precision(given, x, p, free, optimised)
    return found._replace(images=q.images, border=q.border, points=q.points, leverages=q.leverages)


def free_places(plan: EliminationPlan, structure: Structure) -> Int[Array, " free"]:
    """Indices of the free unknowns in the padded vector of the elimination."""
    images, points = len(structure.image_names), len(structure.point_names)
    shapes = (images, 6), structure.interior_free[:, list(structure.interior_columns)].shape
    ones = (np.ones((1, *shape)) for shape in (*shapes, structure.parameter_free.shape, (points, 3)))
    masks = ordered_vectors(plan, structure, BlockVectors(*ones))
    return on_device(np.flatnonzero(np.concatenate([np.ravel(mask) for mask in masks])))


@eqx.filter_custom_jvp
def _precision(
    found: Precision, x: OrderedUnknowns, p: Problem, free: Int[Array, " free"] | None, optimised: bool
) -> Precision:
    return found


@_precision.def_jvp
def _precision_jvp(primals: tuple, tangents: tuple) -> tuple[Precision, Precision]:
    found, x, p, free, optimised = primals
    if free is None:
        return _precision(*primals), _by_engine(found, x, p, tangents[1:3], optimised=optimised)

    def compute(x: OrderedUnknowns, p: Problem) -> Precision:
        return _dense(x, p, free, optimised=optimised)

    return _precision(*primals), eqx.filter_jvp(compute, (x, p), tangents[1:3])[1]


@Compiled
def _by_engine(found: Precision, x: OrderedUnknowns, p: Problem, moved: tuple) -> Precision:
    """The derivative along the tangent `moved`, in forward mode and transposed."""
    vector, restored = ravel_pytree(moved)
    flat, precision = ravel_pytree(found)

    def compute(x: OrderedUnknowns, p: Problem) -> Precision:
        q = cofactors(x, p)
        return Precision(q.images, q.border, q.points, q.leverages)

    def forward(v: Array) -> Array:
        return ravel_pytree(eqx.filter_jvp(compute, (x, p), restored(v))[1])[0]

    def transposed(c: Array) -> Array:
        gradient = cofactor_gradient(x, p, CofactorWeights(*precision(c)))
        wanted = jax.tree.map(lambda m, g: None if m is None else g, moved, gradient, is_leaf=lambda m: m is None)
        return ravel_pytree(wanted)[0]

    return precision(linear_map(forward, transposed, vector, len(flat), (x, p), SECOND))


@Compiled
def _dense(x: OrderedUnknowns, p: Problem, free: Int[Array, " free"]) -> Precision:
    """The cofactors from the full matrix Q."""
    x, p = copied((x, p), p.devices)
    zero = zero_vector(p)
    sizes = np.cumsum([part.size for part in zero])

    def vector(flat: Shaped[Array, " unknown"]) -> NormalVector:
        return NormalVector(*(f.reshape(z.shape) for f, z in zip(jnp.split(flat, sizes[:-1]), zero, strict=True)))

    def residuals(d: Float[Array, " free"]) -> tuple[Array, ...]:
        return tuple(weighted_residuals(moved(x, p, vector(jnp.zeros(sizes[-1]).at[free].set(d))), p))

    columns = jax.jacfwd(residuals)(jnp.zeros(free.shape))
    design = jnp.concatenate([a.reshape(-1, len(free)) for a in columns])
    scale = 1 / jnp.linalg.norm(design, axis=0)
    factor = jax.scipy.linalg.cho_factor((design * scale[None]).T @ (design * scale[None]), lower=True)
    q = scale[:, None] * jax.scipy.linalg.cho_solve(factor, jnp.diag(scale))
    leverages = jnp.sum((design @ q) * design, 1)
    at_residual = np.cumsum([a.size // len(free) for a in columns])
    parts = zip(jnp.split(leverages, at_residual[:-1]), columns, strict=True)
    place = jnp.full(sizes[-1], len(free)).at[free].set(jnp.arange(len(free)))
    return Precision(*_blocks(q, vector(place)), [part.reshape(a.shape[:-1]) for part, a in parts])


def _blocks(q: Float[Array, "free free"], place: NormalVector) -> tuple[Array, Array, Array]:
    """The blocks of Q of images, border and eliminated points; `place`: index of each unknown in Q."""

    def of(rows: Int[Array, "*entity k"]) -> Float[Array, "*entity k k"]:
        return q.at[rows[..., :, None], rows[..., None, :]].get(mode="fill", fill_value=0.0)

    return of(place.images), of(place.border), of(jnp.moveaxis(place.tiles, 0, -1)).transpose(2, 3, 0, 1)
