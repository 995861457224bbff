"""One trial step of the adjustment, on one device or on several.

    linearise and eliminate (tiles)  ->  reduced equations  ->  solve  ->  substitute back and evaluate (tiles)

The tiles are distributed over the devices, and the sums over the images are added; all devices solve the reduced
equations.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float

from jaxbundle.block.unknowns import Unknowns, attitude_curvature, attitude_derivatives, corrected
from jaxbundle.normals.back_substitution import substitute
from jaxbundle.normals.chunks import (
    EVERYWHERE,
    OF_TILES,
    everywhere,
    image_table,
    over_devices,
    problem_parts,
    unknown_parts,
)
from jaxbundle.normals.cost import other_residuals, rounding_noise
from jaxbundle.normals.eliminate import RaySums, eliminate
from jaxbundle.normals.observation_curvature import Rotations, add_curvature
from jaxbundle.normals.observation_rows import add_border_rays, add_group, add_point_terms, group_rows, no_sums
from jaxbundle.normals.pcg import ImplicitEquations
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, ReducedVector
from jaxbundle.normals.reduced_system import ReducedSystem, factorise, step
from jaxbundle.normals.reduced_vector import correction_of, values_along
from jaxbundle.numerics.devices import device_mesh, put


class Trial(NamedTuple):
    """A trial step with some damping; all reductions are of v^T P v / 2."""

    unknowns: OrderedUnknowns
    """The unknowns after the step."""
    cost: Float[Array, ""]
    """v^T P v / 2 before the step."""
    reduction: Float[Array, ""]
    """Reduction of v^T P v / 2 by the step."""
    predicted: Float[Array, ""]
    """Reduction predicted by the linearised equations."""
    residual_change: Float[Array, ""]
    """Squared norm of the change of v, |J d|^2 in first order: a sum of squares without cancellation, unlike g . d."""
    noise: Float[Array, ""]
    """v^T P v / 2 of rounding errors."""
    finite: Bool[Array, ""]
    steepness: Float[Array, ""]
    """Maximum of |J_k^T P v| / |J_k| over all unknowns k before the step: without unit, 0 at a minimum, at most |v|."""


def linearise(unknowns: OrderedUnknowns, p: Problem, exact: bool = False) -> Linearised:
    """Computes the values of a linearisation outside the tiles.

    These are the table of the images and observations other than rays of eliminated points; `exact`: with all second
    derivatives.
    """
    o, images = p.observations, unknowns.images
    d_rotation = attitude_derivatives(images.rotation, o.in_angles, o.system)
    sums = add_border_rays(no_sums(p, images.rotation.shape[1]), images, d_rotation, p)
    flat = unknowns.flat() if o.groups else images
    on_points = any(group.kind.touches == ("point",) for group in o.groups)
    terms = jnp.zeros((9, p.tile_points)) if on_points else None
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        rows = group_rows(group, flat, d_rotation, o.columns)
        sums, terms = add_group(sums, group, rows, pairs, p), add_point_terms(terms, group, rows)
    d2_rotation = attitude_curvature(images.rotation, o.in_angles, o.system) if exact else None
    if d2_rotation is not None:
        sums, terms = add_curvature(sums, terms, unknowns, Rotations(d_rotation, d2_rotation), p)
    return Linearised(
        unknowns,
        p,
        image_table(images, d_rotation, o),
        d_rotation,
        d2_rotation,
        sums,
        None if terms is None else terms.reshape(9, *unknowns.tiles.shape[1:]),
        p.free_tiles,
    )


class Reduced(NamedTuple):
    """The reduced system, and the gradient of images and border before the elimination."""

    system: ReducedSystem
    gradient: ReducedVector


def reduced_system(rays: RaySums, linear: Linearised) -> Reduced:
    """The reduced normal equations of images and border from all sums; `rays`: sums of all devices."""
    p, sums = linear.problem, linear.sums
    d, q, inner = p.layout.image, p.layout.shared, p.layout.first_parameter
    m = d + q + 2
    u, gradient = rays.image[:, :d, :d] + sums.diagonal, rays.image[:, :d, m - 2] + sums.gradient
    coupling, border, border_gradient = sums.coupling, sums.border, sums.border_gradient
    eliminated = jnp.zeros_like(border_gradient)
    if inner:
        rows = p.layout.camera_rows(p.observations.image_camera)
        own = rays.image[:, d : d + q]
        at = jnp.arange(u.shape[0])[:, None, None], jnp.arange(d)[:, None], rows[:, None, :]
        coupling = coupling.at[at].add(rays.image[:, :d, d : d + q]).at[:, :, :inner].add(-rays.coupling)
        border = border.at[rows[:, :, None], rows[:, None, :]].add(own[:, :, d : d + q])
        border_gradient = border_gradient.at[rows].add(own[:, :, m - 2])
        eliminated = eliminated.at[rows].add(own[:, :, m - 1])
    border_diagonal = jnp.diagonal(border)
    if inner:
        border = border.at[:inner, :inner].add(-rays.border)
    pairs, free = -rays.pairs if sums.pairs is None else sums.pairs - rays.pairs, p.free
    system = ReducedSystem(
        pairs.at[p.diagonal_pair].add(u),
        jnp.diagonal(u, axis1=1, axis2=2),
        rays.image[:, :d, m - 1] - gradient,
        free.images,
        coupling,
        border,
        border_diagonal,
        eliminated - border_gradient,
        free.border,
    )
    return Reduced(system, ReducedVector(gradient, border_gradient))


class _RayPart(NamedTuple):
    """Result of the tiles for a step."""

    images: Unknowns
    tiles: Float[Array, "3 tile column"]
    cost: Float[Array, ""]
    reduction: Float[Array, ""]
    residual_change: Float[Array, ""]
    gradient_step: Float[Array, ""]
    damped_step: Float[Array, ""]
    finite: Bool[Array, ""]
    steepness: Float[Array, ""]


def _on_device(linear: Linearised, damping: Array) -> _RayPart:
    """The whole step on one device."""
    p, o = linear.problem, linear.problem.observations
    rays, stored = eliminate(linear, damping)
    reduced = reduced_system(linear.total(rays), linear)
    system, gradient = reduced
    if p.layout.implicit:
        equations = ImplicitEquations(linear, system, stored, damping)
        x = equations.solve(ReducedVector(system.right, system.border_right))
    else:
        x = ReducedVector(*step(p.reduced, factorise(p.reduced, system, damping)))
    after = corrected(linear.unknowns.images, correction_of(x, p, linear.unknowns), o.in_angles, o.system)
    part = substitute(linear, values_along(x, linear), image_table(after, None, o), stored, damping)
    cost, reduction, residual_change, gradient_step, damped_step = linear.total(part[1:-1])
    squares = jnp.sum(system.diagonal * x.images**2) + jnp.sum(system.border_diagonal * x.border**2)
    return _RayPart(
        after,
        part.points,
        cost,
        reduction,
        residual_change,
        gradient_step + gradient.dot(x),
        damped_step + damping * squares,
        jnp.isfinite(jnp.sum(x.images)) & jnp.isfinite(jnp.sum(x.border)) & jnp.isfinite(reduction),
        jnp.maximum(linear.maximum(part.steepness), reduced_steepness(reduced)),
    )


def reduced_steepness(reduced: Reduced) -> Float[Array, ""]:
    """The maximum of g_k^2 / N_kk over the free unknowns of images and border."""
    system, gradient = reduced
    images = system.free & (system.diagonal > 0), gradient.images, system.diagonal
    border = system.border_free & (system.border_diagonal > 0), gradient.border, system.border_diagonal
    steepest = jnp.zeros(())
    for free, g, diagonal in (images, border):
        squares = jnp.where(free, g * g / jnp.where(free, diagonal, 1.0), 0.0)
        steepest = jnp.maximum(steepest, jnp.max(squares, initial=0.0))
    return steepest


def trial_step(unknowns: OrderedUnknowns, p: Problem, damping: Float[Array, ""]) -> Trial:
    """Linearises, eliminates, solves, substitutes back and evaluates."""
    out = _RayPart(everywhere(unknowns.images), OF_TILES, *[EVERYWHERE] * 7)
    part = over_devices(_on_device, linearise(unknowns, p), out, (damping,))
    after = OrderedUnknowns(part.images, part.tiles)
    pairs = list(zip(other_residuals(unknowns, p), other_residuals(after, p), strict=True))
    cost = part.cost + 0.5 * sum(jnp.sum(v * v) for v, _ in pairs)
    # v^2 - w^2 as a product: near the minimum the difference of two nearly equal sums is noise
    reduction = part.reduction + 0.5 * sum(jnp.sum((v - w) * (v + w)) for v, w in pairs)
    return Trial(
        after,
        cost,
        reduction,
        0.5 * (part.damped_step - part.gradient_step),
        part.residual_change + sum(jnp.sum((v - w) ** 2) for v, w in pairs),
        rounding_noise(p),
        part.finite & jnp.isfinite(reduction),
        jnp.sqrt(part.steepness),
    )


def placed(unknowns: OrderedUnknowns, p: Problem, state: Any) -> tuple[OrderedUnknowns, Problem, Any]:
    """Distributes the arguments of the solver like the results of its steps, so that all steps use the same program."""
    if p.devices == 1:
        return unknowns, p, state
    mesh = device_mesh(p.devices)
    parts = unknown_parts(unknowns), problem_parts(p), everywhere(state)
    where = jax.tree.map(lambda part: NamedSharding(mesh, part), parts, is_leaf=lambda x: isinstance(x, PartitionSpec))
    return jax.tree.map(put, (unknowns, p, state), where)
