"""Back-substitution, tile by tile: the points' part of a step, and what the step does to the residuals.

    dX = -L^-T (z + E^T dt) = -L^-T L^-1 (g_X + B^T A dt)

A dt is one forward derivative of the image equation along the step of the images, B^T (...) one transposed one: no row
is formed. The residuals before and after the step come out in the same pass.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import ImagePoint
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.normals.cells import Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.eliminate import FACTOR
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.rows import image_equation


class Substituted(NamedTuple):
    """Points after the step; v^T P v / 2 of the rays before it, its reduction, |change of v|^2; sums over the points.

    `gradient_step` is g . d, `damped_step` d . lambda D d. `steepness`: the maximum of g_k^2 / N_kk over the points.
    """

    points: Float[Array, "3 tile column"]
    cost: Float[Array, ""]
    reduction: Float[Array, ""]
    moved: Float[Array, ""]
    gradient_step: Float[Array, ""]
    damped_step: Float[Array, ""]
    steepness: Float[Array, ""]


def image_values(unknowns: Unknowns, observations: Observations) -> Float[Array, "image number"]:
    """Rotation, centre and interior of every image, one row an image."""
    interior = unknowns.interior[:, observations.image_camera]
    return jnp.concatenate([unknowns.rotation, unknowns.centre, interior]).T


def split_values(numbers: list[Array]) -> tuple[Rotation, Vector, tuple[Scalar, ...]]:
    """A row of `image_values` as rotation, centre and interior."""
    return tuple(numbers[:9]), (numbers[9], numbers[10], numbers[11]), tuple(numbers[12:])


def substitute(
    observations: Observations,
    before: Float[Array, "image number"],
    direction: Float[Array, "image number"],
    after: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    factors: Float[Array, "tile numbers"],
    damping: Array,
    tiles: tuple[Tiles, ...],
) -> Substituted:
    """All chunks of one device. `before`, `direction`, `after`: rows of `image_values` along the step of the images."""
    table = jnp.concatenate([before, direction, after], 1)
    width, n, model = before.shape[1], points.shape[2], observations.model

    def do_chunk(part: Tiles, c: Array, carry: Substituted) -> Substituted:
        chunk = chunk_of(part, c)
        numbers = at_slots(table, chunk.slot_image)
        old, along, new = (split_values(numbers[k * width : (k + 1) * width]) for k in range(3))
        tile = chunk.first_tile + chunk.tile
        point = points_at_cells(chunk, list(points), tile, old[0], old[1])

        def equation(rotation: Rotation, centre: Vector, interior: tuple[Scalar, ...], point: Vector) -> ImagePoint:
            return image_equation(model, rotation, centre, interior, point, chunk.measured, chunk.zero)

        v, moved = jax.jvp(lambda r, x, i: equation(r, x, i, point), old, along)
        _, transposed = jax.vjp(lambda p: equation(*old, p), point)
        (at_points,) = transposed(tuple(w * w * t for w, t in zip(chunk.weights, moved, strict=True)))
        coupled = sum_by_tile(list(at_points), chunk)

        stored = chunk.window(factors)
        number = [stored[:, k * n : (k + 1) * n] for k in range(FACTOR)]
        factor, gradient, diagonal = PointFactor(*number[:6]), number[6:9], number[9:]
        own = (jnp.arange(chunk.most_tiles) < chunk.tile_count)[:, None]
        x, y, z = (g + t for g, t in zip(gradient, coupled, strict=True))
        dx = [jnp.where(own, -d, 0.0) for d in backward(factor, forward(factor, (x, y, z)))]
        stepped = [chunk.window(x) + d for x, d in zip(points, dx, strict=True)]
        zero = jnp.zeros_like(chunk.first_tile)
        moved_points = lax.dynamic_update_slice(carry.points, jnp.stack(stepped), (zero, chunk.first_tile, zero))

        point = points_at_cells(chunk, stepped, chunk.tile, new[0], new[1])
        w = equation(*new, point)
        v, w = ([r * s for r, s in zip(residual, chunk.weights, strict=True)] for residual in (v, w))
        return Substituted(
            moved_points,
            carry.cost + 0.5 * sum(jnp.sum(a * a) for a in v),
            carry.reduction + 0.5 * sum(jnp.sum((a - b) * (a + b)) for a, b in zip(v, w, strict=True)),
            carry.moved + sum(jnp.sum((a - b) ** 2) for a, b in zip(v, w, strict=True)),
            carry.gradient_step + sum(jnp.sum(jnp.where(own, g * d, 0.0)) for g, d in zip(gradient, dx, strict=True)),
            carry.damped_step
            + damping * sum(jnp.sum(jnp.where(own, s * d * d, 0.0)) for s, d in zip(diagonal, dx, strict=True)),
            jnp.maximum(carry.steepness, jnp.max(_steepness(factor, gradient, diagonal, own))),
        )

    zero = jnp.zeros(())
    done = Substituted(points, zero, zero, zero, zero, zero, zero)
    for part in tiles:
        done = lax.fori_loop(0, part.chunks, partial(do_chunk, part), done)
    return done


def _steepness(factor: PointFactor, gradient: list[Array], diagonal: list[Array], own: Array) -> Array:
    """The largest g_k^2 / N_kk of the free coordinates of every point."""
    steep = jnp.zeros(())
    for inverse_pivot, g, s in zip(factor[:3], gradient, diagonal, strict=True):
        free = own & (inverse_pivot != 0) & (s > 0)
        steep = jnp.maximum(steep, jnp.where(free, g * g / jnp.where(free, s, 1.0), 0.0))
    return steep
