"""One trial step of the adjustment, on one device or on several.

    linearise and eliminate (tiles)  ->  reduced equations  ->  solve  ->  substitute back and evaluate (tiles)

The tiles are dealt to the devices, the sums over the images added up over them; all solve the reduced equations.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float

from jaxbundle.block.unknowns import Unknowns, attitude_curvature, attitude_derivatives, corrected
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.eliminate import ImageSums, eliminate, image_table
from jaxbundle.normals.implicit import ImplicitEquations
from jaxbundle.normals.kept import KeptSums, add_group, add_kept_rays, no_sums
from jaxbundle.normals.kept_curvature import add_curvature
from jaxbundle.normals.kept_vector import KeptVector, correction_of, direction_of, kept_free
from jaxbundle.normals.partition import EVERYWHERE, OF_TILES, everywhere, local_tiles, problem_parts, unknown_parts
from jaxbundle.normals.reduced_system import ReducedSystem, factorise, step
from jaxbundle.normals.residuals import other_residuals
from jaxbundle.normals.substitute import image_values, substitute
from jaxbundle.numerics.devices import AXIS, device_mesh, put


class Trial(NamedTuple):
    """A trial step at some damping; all reductions belong to v^T P v / 2.

    `moved` is |change of v|^2, of first order |J d|^2: a sum of squares and so, unlike g . d, free of cancellation.
    `steepness` is the maximum of |J_k^T P v| / |J_k| over all unknowns k, before the step: free of units, 0 at a
    minimum, at most |v|.
    """

    unknowns: Arranged
    cost: Float[Array, ""]
    reduction: Float[Array, ""]
    predicted: Float[Array, ""]
    moved: Float[Array, ""]
    noise: Float[Array, ""]
    finite: Bool[Array, ""]
    steepness: Float[Array, ""]


class Linearised(NamedTuple):
    """What is formed once a linearisation, outside of the tiles."""

    turns: Float[Array, "9 3 image"]
    table: Float[Array, "image number"]
    kept: KeptSums
    prior: Float[Array, "9 tile column"] | None
    bends: Float[Array, "9 3 3 image"] | None = None  # second derivatives of the rotations, where those are wanted


def linearise(unknowns: Arranged, p: Problem, exact: bool = False) -> Linearised:
    """Tables of the images, and the observations that are no rays of eliminated points; `exact`: with all second
    derivatives."""
    o, images, shape = p.observations, unknowns.images, p.shape
    turns = attitude_derivatives(images.rotation, o.in_angles, o.system)
    two_images = any(pairs is not None for pairs in p.group_pairs)
    sums = no_sums(images.rotation.shape[1], shape.image, shape.border, shape.pool if two_images else None)
    sums = add_kept_rays(sums, p.kept_rays, images, turns, o, shape)
    flat = unknowns.flat() if o.groups else images
    on_points = any(group.kind.touches == ("point",) for group in o.groups)
    prior = jnp.zeros((9, unknowns.tiles.shape[1] * unknowns.tiles.shape[2])) if on_points else None
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        sums, prior = add_group(sums, prior, group, pairs, flat, turns, o, shape, p.point_column, p.camera_image)
    bends = attitude_curvature(images.rotation, o.in_angles, o.system) if exact else None
    if bends is not None:
        sums, prior = add_curvature(sums, prior, images, flat, turns, bends, p)
    table = image_table(images, turns, o)
    return Linearised(turns, table, sums, None if prior is None else prior.reshape(9, *unknowns.tiles.shape[1:]), bends)


class Reduced(NamedTuple):
    """The reduced system and the gradient of the kept unknowns before elimination."""

    system: ReducedSystem
    gradient: Float[Array, "image d"]
    border_gradient: Float[Array, " border"]


def reduced_system(rays: ImageSums, kept: KeptSums, p: Problem) -> Reduced:
    """The reduced normal equations of images and border from all sums."""
    o, (d, q, cameras, *_) = p.observations, p.shape
    m, inner = d + q + 2, q * cameras
    u, gradient = rays.image[:, :d, :d] + kept.diagonal, rays.image[:, :d, m - 2] + kept.gradient
    coupling, border, border_gradient = kept.coupling, kept.border, kept.border_gradient
    eliminated = jnp.zeros_like(border_gradient)
    if inner:
        columns = q * o.image_camera[:, None] + jnp.arange(q)
        own = rays.image[:, d : d + q]
        rows = jnp.arange(u.shape[0])[:, None, None], jnp.arange(d)[:, None], columns[:, None, :]
        coupling = coupling.at[rows].add(rays.image[:, :d, d : d + q]).at[:, :, :inner].add(-rays.coupling)
        border = border.at[columns[:, :, None], columns[:, None, :]].add(own[:, :, d : d + q])
        border_gradient = border_gradient.at[columns].add(own[:, :, m - 2])
        eliminated = eliminated.at[columns].add(own[:, :, m - 1])
    border_diagonal = jnp.diagonal(border)
    if inner:
        border = border.at[:inner, :inner].add(-rays.border)
    pool = -rays.pool if kept.pool is None else kept.pool - rays.pool
    free = kept_free(p)
    system = ReducedSystem(
        pool.at[p.diagonal_pair].add(u),
        jnp.diagonal(u, axis1=1, axis2=2),
        rays.image[:, :d, m - 1] - gradient,
        free.images,
        coupling,
        border,
        border_diagonal,
        eliminated - border_gradient,
        free.border,
    )
    return Reduced(system, gradient, border_gradient)


class _RayPart(NamedTuple):
    """What the tiles say of a step."""

    images: Unknowns
    tiles: Float[Array, "3 tile column"]
    cost: Float[Array, ""]
    reduction: Float[Array, ""]
    moved: Float[Array, ""]
    gradient_step: Float[Array, ""]
    damped_step: Float[Array, ""]
    finite: Bool[Array, ""]
    steepness: Float[Array, ""]


def _on_device(
    unknowns: Arranged, linear: Linearised, damping: Array, p: Problem, free: Array, axis: str | None
) -> _RayPart:
    """The whole step as one device sees it; `axis` names the devices, None for a single one."""
    o = p.observations

    def total(x):
        return lax.psum(x, axis) if axis else x

    tiles = local_tiles(p.tiles)
    rays, factors = eliminate(
        o, linear.table, unknowns.tiles, linear.prior, free, damping, tiles, p.shape, p.diagonal_pair
    )
    system, gradient, border_gradient = reduced_system(total(rays), linear.kept, p)
    if p.shape.implicit:
        equations = ImplicitEquations(unknowns, linear.turns, linear.kept, system, factors, damping, p, tiles, axis)
        images, border = equations.solve(KeptVector(system.right, system.border_right))
    else:
        images, border = step(p.reduced, factorise(p.reduced, system, damping))
    correction = correction_of(images, border, p, unknowns)
    direction = direction_of(correction, linear.turns)
    moved = corrected(unknowns.images, correction, o.in_angles, o.system)
    before, along, after = (image_values(u, o) for u in (unknowns.images, direction, moved))
    part = substitute(o, before, along, after, unknowns.tiles, factors, damping, tiles)
    cost, reduction, moved_residuals, gradient_step, damped_step = total(part[1:-1])
    of_points = lax.pmax(part.steepness, axis) if axis else part.steepness
    squares = jnp.sum(system.diagonal * images**2) + jnp.sum(system.border_diagonal * border**2)
    return _RayPart(
        moved,
        part.points,
        cost,
        reduction,
        moved_residuals,
        gradient_step + jnp.sum(gradient * images) + jnp.sum(border_gradient * border),
        damped_step + damping * squares,
        jnp.isfinite(jnp.sum(images)) & jnp.isfinite(jnp.sum(border)) & jnp.isfinite(reduction),
        jnp.maximum(of_points, kept_steepness(system, gradient, border_gradient)),
    )


def kept_steepness(
    system: ReducedSystem, gradient: Float[Array, "image d"], border_gradient: Float[Array, " border"]
) -> Float[Array, ""]:
    """The maximum of g_k^2 / N_kk over the kept unknowns that are free."""
    images = system.free & (system.diagonal > 0), gradient, system.diagonal
    border = system.border_free & (system.border_diagonal > 0), border_gradient, system.border_diagonal
    steepest = jnp.zeros(())
    for free, g, diagonal in (images, border):
        squares = jnp.where(free, g * g / jnp.where(free, diagonal, 1.0), 0.0)
        steepest = jnp.maximum(steepest, jnp.max(squares, initial=0.0))
    return steepest


def trial_step(unknowns: Arranged, p: Problem, damping: Float[Array, ""]) -> Trial:
    """Linearises, eliminates, solves, substitutes back and evaluates."""
    linear = linearise(unknowns, p)
    free = p.free_tiles
    if p.devices == 1:
        part = _on_device(unknowns, linear, damping, p, free, None)
    else:
        part = _on_devices(unknowns, linear, damping, p, free)
    after = Arranged(part.images, part.tiles)
    pairs = list(zip(other_residuals(unknowns, p), other_residuals(after, p), strict=True))
    cost = part.cost + 0.5 * sum(jnp.sum(v * v) for v, _ in pairs)
    # v^2 - w^2 as a product: the difference of two nearly equal sums would be noise near the minimum
    reduction = part.reduction + 0.5 * sum(jnp.sum((v - w) * (v + w)) for v, w in pairs)
    return Trial(
        after,
        cost,
        reduction,
        0.5 * (part.damped_step - part.gradient_step),
        part.moved + sum(jnp.sum((v - w) ** 2) for v, w in pairs),
        rounding_noise(p),
        part.finite & jnp.isfinite(reduction),
        jnp.sqrt(part.steepness),
    )


def partition(unknowns: Arranged, linear: Linearised, p: Problem) -> tuple[Arranged, Linearised, Problem]:
    """How the arguments of a step lie on the devices."""
    prior = None if linear.prior is None else OF_TILES
    return unknown_parts(unknowns), everywhere(linear)._replace(prior=prior), problem_parts(p)


def placed(unknowns: Arranged, p: Problem, state: Any) -> tuple[Arranged, Problem, Any]:
    """Arguments of the solver put where its steps will leave them: the first step runs in the program of the others."""
    if p.devices == 1:
        return unknowns, p, state
    mesh = device_mesh(p.devices)
    parts = unknown_parts(unknowns), problem_parts(p), everywhere(state)
    where = jax.tree.map(lambda part: NamedSharding(mesh, part), parts, is_leaf=lambda x: isinstance(x, PartitionSpec))
    return jax.tree.map(put, (unknowns, p, state), where)


def _on_devices(unknowns: Arranged, linear: Linearised, damping: Array, p: Problem, free: Array) -> _RayPart:
    parts = partition(unknowns, linear, p)
    out_specs = _RayPart(parts[0].images, OF_TILES, *[EVERYWHERE] * 7)
    return jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(parts[0], parts[1], EVERYWHERE, parts[2], OF_TILES),
        out_specs=out_specs,
        check_vma=False,
    )(unknowns, linear, damping, p, free)


def rounding_noise(p: Problem) -> Float[Array, ""]:
    """v^T P v / 2 of residuals that are nothing but rounding: a few operations on image coordinates."""
    eps = 4 * jnp.finfo(p.kept_rays.measured.dtype).eps
    rays = [(x.measured, x.weights) for x in (*p.tiles, p.kept_rays)]
    return 0.5 * eps**2 * sum((jnp.sum((m * w) ** 2) for m, w in rays), jnp.zeros(()))
