"""Weighted residuals of all observations in elimination order, and the differentiable cost v^T P v / 2.

The sum is computed chunk by chunk. A derivative, forward or transposed and of any order, recomputes a chunk instead
of storing intermediate values of all rays, and each device sums its chunks.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Observations, group_residuals, weighted
from jaxbundle.normals.chunks import (
    EVERYWHERE,
    OF_TILES,
    image_table,
    is_used,
    problem_parts,
    split_values,
)
from jaxbundle.normals.problem import OrderedUnknowns, Problem, Tiles
from jaxbundle.normals.rows import Image, image_equation
from jaxbundle.numerics.devices import AXIS, device_mesh


def cost(unknowns: OrderedUnknowns, p: Problem) -> Float[Array, ""]:
    """v^T P v / 2."""
    values, others = image_table(unknowns.images, None, p.observations), other_residuals(unknowns, p)
    rest = 0.5 * sum((jnp.sum(v * v) for v in others), jnp.zeros(()))
    if p.devices == 1:
        return _cost_of_tiles(p, values, unknowns.tiles) + rest

    def on_device(p: Problem, values: Array, points: Array) -> Array:
        return lax.psum(_cost_of_tiles(p, values, points), AXIS)

    of_rays = jax.shard_map(
        on_device,
        mesh=device_mesh(p.devices),
        in_specs=(problem_parts(p), EVERYWHERE, OF_TILES),
        out_specs=EVERYWHERE,
        check_vma=False,
    )
    return of_rays(p, values, unknowns.tiles) + rest


def _cost_of_tiles(
    p: Problem, values: Float[Array, "image number"], points: Float[Array, "3 tile column"]
) -> Float[Array, ""]:
    """The cost v^T P v / 2 of the rays of one device, whose tiles have a leading device axis of length 1."""
    total = jnp.zeros(())

    @jax.checkpoint
    def of_chunk(
        numbers: Float[Array, "slot number"],
        window: Float[Array, "3 tile column"],
        tile: Int[Array, " slot"],
        measured: Float[Array, "measured slot column"],
        weights: Float[Array, "component slot column"],
    ) -> Float[Array, ""]:
        image = split_values([numbers[:, k, None] for k in range(numbers.shape[1])])
        x, y, z = (jnp.take(coordinate, tile, axis=0, mode="clip") for coordinate in window)
        v = _residuals(p.observations, _Rays(image, (x, y, z), measured, weights), tile[0])
        return 0.5 * sum((jnp.sum(r * r) for r in v), jnp.zeros(()))

    for part in p.tiles:
        slot_image, slot_tile, measured, weights = (
            x[0] for x in (part.slot_image, part.slot_tile, part.measured, part.weights)
        )
        # the input of all chunks is arranged before: derivatives of each chunk with respect to all images would be
        # summed each time
        window = jnp.moveaxis(points.at[:, _tiles_of_chunks(slot_tile, part)].get(mode="clip"), 0, 1)
        chunks = values[slot_image], window, slot_tile - slot_tile[:, :1], measured, weights
        total, _ = lax.scan(lambda sum_, chunk: (sum_ + of_chunk(*chunk), None), total, chunks)
    return total


def _tiles_of_chunks(slot_tile: Int[Array, "chunk slot"], part: Tiles) -> Int[Array, "chunk tile"]:
    return slot_tile[:, :1] + jnp.arange(part.max_tiles, dtype=jnp.int32)[None]


def other_residuals(unknowns: OrderedUnknowns, p: Problem) -> list[Array]:
    """Weighted residuals of all observations except cells: rays of border points, and groups of other observations."""
    residuals, rays, o = [], p.border_rays, p.observations
    if rays:
        u = unknowns.images
        interior = tuple(u.interior[:, o.image_camera[rays.image]])
        centre = u.centre[:, rays.image]
        image = tuple(u.rotation[:, rays.image]), (centre[0], centre[1], centre[2]), interior
        residuals += _residuals(o, _Rays(image, tuple(u.points[:, rays.point]), rays.measured, rays.weights))
    if o.groups:
        flat = unknowns.flat()
        residuals += [weighted(group_residuals(flat, group), group) for group in o.groups]
    return residuals


def weighted_residuals(unknowns: OrderedUnknowns, p: Problem) -> list[Array]:
    """Weighted residuals of all observations.

    Cells come first, one array per component and part, 0 without ray.
    """
    values, cells = image_table(unknowns.images, None, p.observations), []
    first = unknowns.tiles.shape[1] // p.devices * jnp.arange(p.devices, dtype=jnp.int32)[:, None, None]
    for part in p.tiles:
        number = jnp.moveaxis(values[part.slot_image], -1, 0)[..., None]
        points = tuple(unknowns.tiles[:, part.slot_tile + first])
        measured, weights = (jnp.moveaxis(x, 2, 0) for x in (part.measured, part.weights))
        cells += _residuals(p.observations, _Rays(split_values(list(number)), points, measured, weights))
    return [*cells, *other_residuals(unknowns, p)]


def ray_arrays(p: Problem) -> int:
    """Number of arrays of `weighted_residuals` that belong to rays; the others belong to the groups."""
    return p.observations.model.components * (len(p.tiles) + bool(p.border_rays))


def rounding_noise(p: Problem) -> Float[Array, ""]:
    """The cost v^T P v / 2 of rounding errors: a few operations on the measured numbers."""
    eps = 4 * jnp.finfo(p.border_rays.measured.dtype).eps
    rays = [(t.measured, t.weights, 2) for t in p.tiles] + [(p.border_rays.measured, p.border_rays.weights, 0)]
    sizes = [lax.slice_in_dim(m, 0, w.shape[axis], axis=axis) * w for m, w, axis in rays]
    sizes += [g.weights * (g.values if g.weights.ndim == 2 else g.values[None]) for g in p.observations.groups]
    return 0.5 * eps**2 * sum((jnp.sum(size**2) for size in sizes), jnp.zeros(()))


class _Rays(NamedTuple):
    """Rays in any arrangement, with their input."""

    image: Image
    points: tuple[Array, ...]
    measured: Array
    weights: Array


def _residuals(o: Observations, rays: _Rays, zero: Int[Array, ""] | None = None) -> list[Array]:
    """Weighted residuals of rays. A ray without weight has a point in front of its camera: derivatives stay finite."""
    rotation, centre, _ = rays.image
    ahead, used = [x - r for x, r in zip(centre, rotation[2::3], strict=True)], is_used(rays.weights)
    x, y, z = (jnp.where(used, x, a) for x, a in zip(rays.points, ahead, strict=True))
    v = image_equation(o.model, rays.image, (x, y, z), tuple(rays.measured), zero)
    return [r * w for r, w in zip(v, rays.weights, strict=True)]
