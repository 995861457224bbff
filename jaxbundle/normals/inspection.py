"""Inspection of an end point by one undamped linearisation: minimum or not, and undetermined unknowns.

    steepness     max |J_k^T P v| / |J_k|      over all unknowns k: 0 at a minimum, at most |v|
    pivots        the share of its normal equation that is independent of the unknowns before it: 0 if undetermined

If the reduced equations are not formed, there is no factorisation. Then conjugate gradients solve S x = b for a
right-hand side of random signs: x is one step of inverse iteration, so the weakest direction dominates; a search
direction without curvature is detected earlier. Directions with a share below `TOLERANCE` in the right-hand side are
not found, and several directions appear as one mixture.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.normals.chunks import BY_DEVICE, EVERYWHERE, over_devices
from jaxbundle.normals.eliminate import eliminate
from jaxbundle.normals.pcg import MAX_ITERATIONS, ImplicitEquations
from jaxbundle.normals.point_blocks import point_equations
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, ReducedVector
from jaxbundle.normals.reduced_system import ReducedFactor, ReducedSystem, factorise
from jaxbundle.normals.step import Reduced, linearise, reduced_steepness, reduced_system
from jaxbundle.numerics.conjugate_gradients import softest_direction

TOLERANCE = 1e-6  # share of the right-hand side of the inverse iteration
WEAKEST_SHARE = 1e-11  # share of its normal equation: below this, rounding determines the unknown


class Softest(NamedTuple):
    """A direction of images and border, and its quotient x^T S x / x^T D x with the diagonal D of N."""

    direction: ReducedVector
    share: Float[Array, ""]


class Inspection(NamedTuple):
    """Shares of the pivots in elimination order, 1 for fixed unknowns."""

    image_pivots: Float[Array, "image d"]
    border_pivots: Float[Array, " border"]
    point_pivots: Float[Array, "tile column"]
    system: ReducedSystem
    """The equations, for finding the cause of a failed pivot."""
    steepness: Float[Array, ""]
    softest: Softest | None
    """Only if the reduced equations are not formed; then the pivots are those of the preconditioner."""


INSPECTION_PARTS = Inspection(EVERYWHERE, EVERYWHERE, BY_DEVICE, EVERYWHERE, EVERYWHERE, EVERYWHERE)


def inspection(unknowns: OrderedUnknowns, p: Problem) -> Inspection:
    """The undamped equations at the unknowns, eliminated and factorised."""
    return over_devices(_on_device, linearise(unknowns, p), INSPECTION_PARTS)


def _on_device(linear: Linearised) -> Inspection:
    reduced, stored = _eliminated(linear)
    if linear.problem.layout.implicit:
        equations = ImplicitEquations(linear, reduced.system, stored, jnp.zeros(()))
        found = inspected(linear, reduced, equations.preconditioner(), stored)
        return found._replace(softest=_softest(equations))
    factor = factorise(linear.problem.reduced, reduced.system, jnp.zeros(()))
    return inspected(linear, reduced, factor, stored)


def _eliminated(linear: Linearised) -> tuple[Reduced, Float[Array, "tile value"]]:
    """The reduced equations without damping, and the equations of the points of this device."""
    rays, stored = eliminate(linear, jnp.zeros(()))
    return reduced_system(linear.total(rays), linear), stored


def inspected(
    linear: Linearised, reduced: Reduced, factor: ReducedFactor, stored: Float[Array, "tile value"]
) -> Inspection:
    """The inspection from the results of an elimination; `stored`: equations of the points of this device."""
    points = point_equations(stored, linear.width)
    pivots, steepness = jnp.ones_like(points.gradient[0]), jnp.zeros(())
    for inverse_pivot, gradient, diagonal in zip(points.factor[:3], points.gradient, points.diagonal, strict=True):
        free = (inverse_pivot != 0) & (diagonal > 0)
        own = jnp.where(free, diagonal, 1.0)
        pivots = jnp.minimum(pivots, jnp.where(free, 1 / jnp.where(free, inverse_pivot**2 * own, 1.0), 1.0))
        steepness = jnp.maximum(steepness, jnp.max(jnp.where(free, gradient**2 / own, 0.0), initial=0.0))
    # a check, not a result; the maximum over devices has no derivative
    steepness = linear.maximum(lax.stop_gradient(steepness))
    return Inspection(
        factor.pivots,
        factor.border_pivots,
        pivots,
        reduced.system,
        jnp.sqrt(jnp.maximum(steepness, reduced_steepness(reduced))),
        None,
    )


def reduced_products(unknowns: OrderedUnknowns, p: Problem, vectors: ReducedVector) -> ReducedVector:
    """The products S x for all vectors of the leading axis, if the reduced equations are not formed."""
    return over_devices(_products, linearise(unknowns, p), EVERYWHERE, (vectors,))


def _products(linear: Linearised, vectors: ReducedVector) -> ReducedVector:
    reduced, stored = _eliminated(linear)
    return lax.map(ImplicitEquations(linear, reduced.system, stored, jnp.zeros(())).product, vectors)


def _softest(equations: ImplicitEquations) -> Softest:
    """One step of inverse iteration by conjugate gradients."""
    system = equations.system
    signs = np.random.default_rng(0)
    lengths = ReducedVector(jnp.sqrt(system.diagonal), jnp.sqrt(system.border_diagonal))
    right = jax.tree.map(lambda x: x * signs.choice([-1.0, 1.0], x.shape), lengths)
    direction = softest_direction(
        equations.product,
        equations.preconditioned(),
        equations.only_free(right),
        ReducedVector.dot,
        WEAKEST_SHARE,
        TOLERANCE,
        MAX_ITERATIONS,
    )
    size = jnp.sum(system.diagonal * direction.images**2) + jnp.sum(system.border_diagonal * direction.border**2)
    return Softest(direction, direction.dot(equations.product(direction)) / size)
