"""Weighted residuals of all observations in the order of elimination, and v^T P v / 2, which can be differentiated.

The sum runs through the tiles chunk by chunk. A derivative, forward or transposed and of any order, computes a chunk
again instead of keeping what it needs of every ray, and sums on each device the chunks that are its own.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Observations, group_residuals, weighted
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles
from jaxbundle.normals.partition import EVERYWHERE, OF_TILES, local_tiles, problem_parts
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.substitute import image_values, split_values
from jaxbundle.numerics.devices import AXIS, device_mesh


def cost(unknowns: Arranged, p: Problem) -> Float[Array, ""]:
    """v^T P v / 2."""
    values, others = image_values(unknowns.images, p.observations), other_residuals(unknowns, p)
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
    """Of the rays of one device."""
    total = jnp.zeros(())

    @jax.checkpoint
    def of_chunk(
        numbers: Float[Array, "slot number"],
        window: Float[Array, "3 tile column"],
        tile: Int[Array, " slot"],
        measured: Float[Array, "2 slot column"],
        weights: Float[Array, "2 slot column"],
    ) -> Float[Array, ""]:
        image = split_values([numbers[:, k, None] for k in range(numbers.shape[1])])
        x, y, z = (jnp.take(coordinate, tile, axis=0, mode="clip") for coordinate in window)
        v = _residuals(p.observations, image, (x, y, z), measured, weights, tile[0])
        return 0.5 * (jnp.sum(v[0] * v[0]) + jnp.sum(v[1] * v[1]))

    for part in local_tiles(p.tiles):
        # what a chunk needs is laid out before: a derivative by all images or points a chunk would be summed each time
        window = jnp.moveaxis(points.at[:, _tiles_of_chunks(part)].get(mode="clip"), 0, 1)
        tile = part.slot_tile - part.slot_tile[:, :1]
        chunks = values[part.slot_image], window, tile, part.measured, part.weights
        total, _ = lax.scan(lambda sum_, chunk: (sum_ + of_chunk(*chunk), None), total, chunks)
    return total


def _tiles_of_chunks(part: Tiles) -> Int[Array, "chunk tile"]:
    return part.slot_tile[:, :1] + jnp.arange(part.most_tiles)


def other_residuals(unknowns: Arranged, p: Problem) -> list[Array]:
    """Weighted residuals of everything but the cells: rays of kept points, and observations that are no rays."""
    residuals, rays, o = [], p.kept_rays, p.observations
    if rays.image.shape[0]:
        u = unknowns.images
        image = tuple(u.rotation[:, rays.image]), tuple(u.centre[:, rays.image])
        interior = tuple(u.interior[:, o.image_camera[rays.image]])
        residuals += _residuals(o, (*image, interior), tuple(u.points[:, rays.point]), rays.measured, rays.weights)
    if o.groups:
        flat = unknowns.flat()
        residuals += [weighted(group_residuals(flat, group), group) for group in o.groups]
    return residuals


def weighted_residuals(unknowns: Arranged, p: Problem) -> list[Array]:
    """Weighted residuals of all observations; cells first, two arrays a part, 0 where there is no ray."""
    values, cells = image_values(unknowns.images, p.observations), []
    first = unknowns.tiles.shape[1] // p.devices * jnp.arange(p.devices)[:, None, None]
    for part in p.tiles:
        number = jnp.moveaxis(values[part.slot_image], -1, 0)[..., None]
        points = tuple(unknowns.tiles[:, part.slot_tile + first])
        measured, weights = (jnp.moveaxis(x, 2, 0) for x in (part.measured, part.weights))
        cells += _residuals(p.observations, split_values(list(number)), points, measured, weights)
    return [*cells, *other_residuals(unknowns, p)]


def _residuals(
    o: Observations,
    image: tuple,
    points: tuple[Array, ...],
    measured: Array,
    weights: Array,
    zero: Int[Array, ""] | None = None,
) -> list[Array]:
    """Weighted residuals of rays. One without weight gets a point in front of its camera: derivatives stay finite."""
    rotation, centre, interior = image
    used = (weights[0] > 0) | (weights[1] > 0)
    ahead = [x - r for x, r in zip(centre, rotation[2::3], strict=True)]
    x, y, z = (jnp.where(used, x, a) for x, a in zip(points, ahead, strict=True))
    v = image_equation(o.model, rotation, centre, interior, (x, y, z), (measured[0], measured[1]), zero)
    return [r * w for r, w in zip(v, weights, strict=True)]
