"""Back-substitution, tile by tile: corrections of the points, and the change of the residuals by the step.

    dX = -L^-T (z + E^T dt) = -L^-T L^-1 (g_X + B^T A dt)

A dt is one forward derivative of the image equation along the step of the images, B^T (...) one transposed derivative:
no rows are formed. The same pass computes the residuals before and after the step.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.normals.chunks import chunk_rays, for_chunks, in_tiles, points_at_cells, split_values, sum_by_tile
from jaxbundle.normals.point_blocks import PointEquations, backward, forward, point_equations
from jaxbundle.normals.problem import Linearised, Tiles


class Substituted(NamedTuple):
    """Points after the step, and sums over the rays and points of the tiles; v^T P v / 2 is that of the rays."""

    points: Float[Array, "3 tile column"]
    cost: Float[Array, ""]
    """v^T P v / 2 before the step."""
    reduction: Float[Array, ""]
    """Reduction of v^T P v / 2 by the step."""
    residual_change: Float[Array, ""]
    """Squared norm of the change of v."""
    gradient_step: Float[Array, ""]
    """Product g . d of the points."""
    damped_step: Float[Array, ""]
    """Product d . lambda D d of the points."""
    steepness: Float[Array, ""]
    """Maximum of g_k^2 / N_kk over the points."""


def substitute(
    linear: Linearised,
    direction: Float[Array, "image number"],
    after: Float[Array, "image number"],
    stored: Float[Array, "tile value"],
    damping: Array,
) -> Substituted:
    """All chunks of one device. `direction`, `after`: values of the images along the step and after it."""
    table = jnp.concatenate([linear.values, direction, after], 1)
    width, n, points = linear.values.shape[1], linear.width, linear.unknowns.tiles

    def do_chunk(part: Tiles, c: Array, carry: Substituted) -> Substituted:
        rays = chunk_rays(linear, part, c, table)
        chunk, old = rays.chunk, rays.image
        along, new = (split_values(rays.numbers[k * width : (k + 1) * width]) for k in (1, 2))
        v, dv = jax.jvp(lambda image: rays.equation(image, rays.point), (old,), (along,))
        _, transposed = jax.vjp(lambda point: rays.equation(old, point), rays.point)
        (at_points,) = transposed(tuple(w * w * t for w, t in zip(chunk.weights, dv, strict=True)))
        coupled = sum_by_tile(list(at_points), chunk)

        equations = point_equations(chunk.window(stored), n)
        own = (jnp.arange(chunk.max_tiles, dtype=jnp.int32) < chunk.tile_count)[:, None]
        x, y, z = (g + t for g, t in zip(equations.gradient, coupled, strict=True))
        dx = [jnp.where(own, -d, 0.0) for d in backward(equations.factor, forward(equations.factor, (x, y, z)))]
        stepped = [chunk.window(x) + d for x, d in zip(points, dx, strict=True)]

        w = rays.equation(new, points_at_cells(chunk, stepped, chunk.tile, new[0], new[1]))
        v, w = ([r * s for r, s in zip(residual, chunk.weights, strict=True)] for residual in (v, w))
        steps = [zip(x, dx, strict=True) for x in (equations.gradient, equations.diagonal)]
        return Substituted(
            in_tiles(stepped, chunk, carry.points),
            carry.cost + 0.5 * sum(jnp.sum(a * a) for a in v),
            carry.reduction + 0.5 * sum(jnp.sum((a - b) * (a + b)) for a, b in zip(v, w, strict=True)),
            carry.residual_change + sum(jnp.sum((a - b) ** 2) for a, b in zip(v, w, strict=True)),
            carry.gradient_step + sum(jnp.sum(jnp.where(own, g * d, 0.0)) for g, d in steps[0]),
            carry.damped_step + damping * sum(jnp.sum(jnp.where(own, s * d * d, 0.0)) for s, d in steps[1]),
            jnp.maximum(carry.steepness, jnp.max(_steepness(equations, own))),
        )

    zero = jnp.zeros(())
    return for_chunks(linear.problem.tiles, do_chunk, Substituted(points, zero, zero, zero, zero, zero, zero))


def _steepness(equations: PointEquations, own: Array) -> Array:
    """The maximum of g_k^2 / N_kk over the free coordinates of each point."""
    steep = jnp.zeros(())
    for inverse_pivot, g, s in zip(equations.factor[:3], equations.gradient, equations.diagonal, strict=True):
        free = own & (inverse_pivot != 0) & (s > 0)
        steep = jnp.maximum(steep, jnp.where(free, g * g / jnp.where(free, s, 1.0), 0.0))
    return steep
