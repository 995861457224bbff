"""What one undamped linearisation tells of an end point: whether it is a minimum, and which unknowns it determines.

    steepness     max |J_k^T P v| / |J_k|      over all unknowns k: 0 at a minimum, at most |v|
    pivots        the share of its own normal equation that the unknowns before it cannot imitate: 0 if undetermined

Where the reduced equations are not formed there is no factorisation. There conjugate gradients solve S x = b for a
right-hand side of random signs: x is one step of inverse iteration and so leans to the direction that the observations
determine least; a search direction without curvature shows itself before. What the right-hand side holds less than
`TOLERANCE` of is not found, and of several directions one mixture.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.eliminate import eliminate
from jaxbundle.normals.implicit import MOST_ITERATIONS, ImplicitEquations
from jaxbundle.normals.kept_vector import KeptVector
from jaxbundle.normals.partition import EVERYWHERE, OF_TILES, local_tiles
from jaxbundle.normals.reduced_system import ReducedFactor, ReducedSystem, factorise
from jaxbundle.normals.step import Linearised, Reduced, kept_steepness, linearise, partition, reduced_system
from jaxbundle.numerics.conjugate_gradients import softest_direction
from jaxbundle.numerics.devices import AXIS, device_mesh

TOLERANCE = 1e-6  # of the right-hand side of the inverse iteration
WEAKEST_SHARE = 1e-11  # of its own normal equation: below, rounding decides about the unknown


class Softest(NamedTuple):
    """A direction of the kept unknowns, and its share of the diagonal of N: x^T S x / x^T D x."""

    direction: KeptVector
    share: Float[Array, ""]


class Inspection(NamedTuple):
    """Shares of the pivots in the order of elimination, 1 for what is held. `system`: for who asks why one failed.

    `softest`: where the reduced equations are not formed; there the pivots are those of the preconditioner.
    """

    image_pivots: Float[Array, "image d"]
    border_pivots: Float[Array, " border"]
    point_pivots: Float[Array, "tile column"]
    system: ReducedSystem
    steepness: Float[Array, ""]
    softest: Softest | None


def inspection(unknowns: Arranged, p: Problem) -> Inspection:
    """The undamped equations at the unknowns, eliminated and factorised."""
    linear, free = linearise(unknowns, p), p.free_tiles
    if p.devices == 1:
        return _on_device(unknowns, linear, p, free, None)
    parts = partition(unknowns, linear, p)
    return jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(*parts, OF_TILES),
        out_specs=inspection_parts(),
        check_vma=False,
    )(unknowns, linear, p, free)


def inspection_parts() -> Inspection:
    """How an inspection lies on the devices."""
    of_tiles: Any = jax.sharding.PartitionSpec(AXIS)
    return Inspection(EVERYWHERE, EVERYWHERE, of_tiles, EVERYWHERE, EVERYWHERE, EVERYWHERE)


def _on_device(unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None) -> Inspection:
    if p.shape.implicit:
        equations, reduced = _implicit(unknowns, linear, p, free, axis)
        found = inspected(reduced, equations.preconditioner(), equations.factors, unknowns, axis)
        return found._replace(softest=_softest(equations))
    reduced, factors = _eliminated(unknowns, linear, p, free, axis)
    return inspected(reduced, factorise(p.reduced, reduced.system, jnp.zeros(())), factors, unknowns, axis)


def _eliminated(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None
) -> tuple[Reduced, Float[Array, "tile numbers"]]:
    """The reduced equations without damping, and the factors of the points of this device."""
    tiles = local_tiles(p.tiles)
    rays, factors = eliminate(
        p.observations,
        linear.table,
        unknowns.tiles,
        linear.prior,
        free,
        jnp.zeros(()),
        tiles,
        p.shape,
        p.diagonal_pair,
    )
    return reduced_system(lax.psum(rays, axis) if axis else rays, linear.kept, p), factors


def _implicit(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None
) -> tuple[ImplicitEquations, Reduced]:
    """The same where the reduced equations are not formed."""
    reduced, factors = _eliminated(unknowns, linear, p, free, axis)
    zero, tiles = jnp.zeros(()), local_tiles(p.tiles)
    equations = ImplicitEquations(unknowns, linear.turns, linear.kept, reduced.system, factors, zero, p, tiles, axis)
    return equations, reduced


def inspected(
    reduced: Reduced, factor: ReducedFactor, factors: Float[Array, "tile numbers"], unknowns: Arranged, axis: str | None
) -> Inspection:
    """The inspection from what an elimination has left. `factors`: of the points of this device."""
    n = unknowns.tiles.shape[2]
    number = [factors[:, k * n : (k + 1) * n] for k in range(12)]
    pivots, steepness = jnp.ones_like(number[0]), jnp.zeros(())
    for inverse_pivot, gradient, diagonal in zip(number[:3], number[6:9], number[9:], strict=True):
        free = (inverse_pivot != 0) & (diagonal > 0)
        own = jnp.where(free, diagonal, 1.0)
        pivots = jnp.minimum(pivots, jnp.where(free, 1 / jnp.where(free, inverse_pivot**2 * own, 1.0), 1.0))
        steepness = jnp.maximum(steepness, jnp.max(jnp.where(free, gradient**2 / own, 0.0), initial=0.0))
    steepness = lax.stop_gradient(steepness)  # a verdict, not a result; the maximum over devices has no derivative
    steepness = lax.pmax(steepness, axis) if axis else steepness
    of_kept = kept_steepness(reduced.system, reduced.gradient, reduced.border_gradient)
    return Inspection(
        factor.pivots,
        factor.border_pivots,
        pivots,
        reduced.system,
        jnp.sqrt(jnp.maximum(steepness, of_kept)),
        None,
    )


def reduced_products(unknowns: Arranged, p: Problem, vectors: KeptVector) -> KeptVector:
    """S x for every vector of the leading axis, where the reduced equations are not formed."""
    linear, free = linearise(unknowns, p), p.free_tiles
    if p.devices == 1:
        return _products_on_device(unknowns, linear, p, free, vectors, None)
    return jax.shard_map(
        partial(_products_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(*partition(unknowns, linear, p), OF_TILES, EVERYWHERE),
        out_specs=EVERYWHERE,
        check_vma=False,
    )(unknowns, linear, p, free, vectors)


def _products_on_device(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, vectors: KeptVector, axis: str | None
) -> KeptVector:
    equations = _implicit(unknowns, linear, p, free, axis)[0]
    return lax.map(equations.product, vectors)


def _softest(equations: ImplicitEquations) -> Softest:
    """One step of inverse iteration by conjugate gradients."""
    system = equations.system
    signs = np.random.default_rng(0)
    lengths = KeptVector(jnp.sqrt(system.diagonal), jnp.sqrt(system.border_diagonal))
    right = jax.tree.map(lambda x: x * signs.choice([-1.0, 1.0], x.shape), lengths)
    direction = softest_direction(
        equations.product,
        equations.preconditioned(),
        equations.only_free(right),
        KeptVector.dot,
        WEAKEST_SHARE,
        TOLERANCE,
        MOST_ITERATIONS,
    )
    size = jnp.sum(system.diagonal * direction.images**2) + jnp.sum(system.border_diagonal * direction.border**2)
    return Softest(direction, direction.dot(equations.product(direction)) / size)
