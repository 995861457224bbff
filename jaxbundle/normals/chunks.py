"""Chunks of tiles: rays as a dense grid of image slots by points; the loop over chunks, and their devices.

A cell array is (slot, column), an array of slots (slot, 1), an array of tiles (tile, column). Cell arrays
are concatenated along the last axis, which is long.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial, reduce
from operator import or_
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel, Measured, Residual
from jaxbundle.geometry.rotation import Rotation
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, Tiles
from jaxbundle.normals.rows import Image, ImageScalars, image_equation
from jaxbundle.numerics.devices import AXIS, device_mesh
from jaxbundle.numerics.stored import stored

Carry = TypeVar("Carry")

EVERYWHERE: Any = PartitionSpec()
BY_DEVICE: Any = PartitionSpec(AXIS)  # PartitionSpec of arrays with a leading device axis
OF_TILES: Any = PartitionSpec(None, AXIS)  # PartitionSpec of arrays (3, tile, column)


class Chunk(NamedTuple):
    """The arrays of one chunk."""

    slot_image: Int[Array, " slot"]
    """Image of each slot."""
    first_tile: Int[Array, ""]
    """Number of the first tile on the device."""
    tile: Int[Array, " slot"]
    """Tile of each slot, relative to the first tile."""
    measured: Measured
    weights: tuple[Array, ...]
    used: Bool[Array, "slot column"]
    """Mask of cells with a ray."""
    max_tiles: int
    """Maximum number of tiles of any chunk."""

    @property
    def tile_count(self) -> Int[Array, ""]:
        """Number of tiles of the device."""
        return self.tile[-1] + 1

    @property
    def zero(self) -> Int[Array, ""]:
        """A 0 that is known only at run time; see `stored`."""
        return jnp.minimum(self.first_tile, 0)

    def window(self, of_tiles: Array) -> Array:
        """The chunk's part of an array with one row per tile, followed by rows of the next chunks."""
        return lax.dynamic_slice_in_dim(of_tiles, self.first_tile, self.max_tiles, 0)

    def at_slots(self, of_tiles: Any) -> Array:
        """Rows of the chunk's tiles at the slots."""
        return jnp.take(of_tiles, self.tile, axis=0, mode="clip")


def chunk_of(tiles: Tiles, c: Array) -> Chunk:
    """The chunk with number `c`."""
    slot_image, tile, measured, weights = (
        lax.dynamic_index_in_dim(x, c, 0, False)
        for x in (tiles.slot_image, tiles.slot_tile, tiles.measured, tiles.weights)
    )
    measured, weights = tuple(measured), tuple(weights)
    return Chunk(slot_image, tile[0], tile - tile[0], measured, weights, is_used(weights), tiles.max_tiles)


def is_used(weights: Any) -> Bool[Array, "*cell"]:
    """Mask of cells with a ray, which has a residual with a weight."""
    return reduce(or_, (w > 0 for w in weights))


def for_chunks(parts: tuple[Tiles, ...], body: Callable[[Tiles, Array, Carry], Carry], carry: Carry) -> Carry:
    """Loops over all chunks of this device, part after part."""
    for part in parts:
        carry = lax.fori_loop(0, part.chunks, partial(body, part), carry)
    return carry


def image_table(
    unknowns: Unknowns, d_rotation: Float[Array, "9 3 image"] | None, observations: Observations
) -> Float[Array, "image number"]:
    """Table of the images with the input of the rays.

    Each row has rotation, centre and interior elements, followed by the derivatives of the rotation, if given.
    """
    interior = unknowns.interior[:, observations.image_camera]
    derivatives = [] if d_rotation is None else [d_rotation.transpose(1, 0, 2).reshape(27, -1)]
    return jnp.concatenate([unknowns.rotation, unknowns.centre, interior, *derivatives]).T


def split_values(numbers: list[Array]) -> Image:
    """Numbers of an image without derivatives, as arguments of the image equation."""
    return tuple(numbers[:9]), (numbers[9], numbers[10], numbers[11]), tuple(numbers[12:])


def image_scalars(numbers: list[Array]) -> ImageScalars:
    """Numbers of an image with the derivatives of its rotation."""
    rotation, centre, interior = split_values(numbers[:-27])
    turned = tuple(tuple(numbers[-27:][9 * a : 9 * a + 9]) for a in range(3))
    return ImageScalars(rotation, (turned[0], turned[1], turned[2]), centre, interior)


def at_slots(rows: Float[Array, "row number"], index: Int[Array, " slot"]) -> list[Float[Array, "slot 1"]]:
    """Numbers of each slot's image, as columns that broadcast over cells."""
    taken = jnp.take(rows, index, axis=0, mode="clip")
    return [taken[:, k][:, None] for k in range(taken.shape[1])]


def points_at_cells(chunk: Chunk, points: list[Array], tile: Array, rotation: Rotation, centre: Vector) -> Vector:
    """Point of each cell; a cell without ray has a point in front of its camera, so its rows are 0."""
    ahead = [x - r for x, r in zip(centre, rotation[2::3], strict=True)]
    x, y, z = (
        jnp.where(chunk.used, jnp.take(coordinate, tile, axis=0, mode="clip"), safe)
        for coordinate, safe in zip(points, ahead, strict=True)
    )
    return x, y, z


class ChunkRays(NamedTuple):
    """The rays of a chunk with their input; the columns of `numbers` are those of the table at the slots."""

    chunk: Chunk
    model: CameraModel
    numbers: list[Array]
    image: Image
    point: Vector

    def equation(self, image: Image, point: Vector) -> Residual:
        """Weighted residuals of the rays of the chunk."""
        return image_equation(self.model, image, point, self.chunk.measured, self.chunk.zero)


def chunk_rays(linear: Linearised, part: Tiles, c: Array, table: Float[Array, "image number"]) -> ChunkRays:
    """The rays of chunk `c`; `table` starts with the values of the images."""
    chunk = chunk_of(part, c)
    numbers = at_slots(table, chunk.slot_image)
    image = split_values(numbers[: linear.values.shape[1]])
    points, tile = list(linear.unknowns.tiles), chunk.first_tile + chunk.tile
    point = points_at_cells(chunk, points, tile, image[0], image[1])
    return ChunkRays(chunk, linear.problem.observations.model, numbers, image, point)


def sum_by_tile(cells: Sequence[Any], chunk: Chunk) -> list[Array]:
    """Sums of several cell arrays over the slots of each tile: (tile, column) each."""
    n = cells[0].shape[1]
    joined = jnp.concatenate(stored(cells, chunk.zero), 1)
    zero = jnp.zeros((chunk.max_tiles, joined.shape[1]))
    sums = zero.at[chunk.tile].add(joined, mode="promise_in_bounds", indices_are_sorted=True)
    return [sums[:, k * n : (k + 1) * n] for k in range(len(cells))]


def in_tiles(rows: list[Array], chunk: Chunk, of_tiles: Float[Array, "3 tile column"]) -> Float[Array, "3 tile column"]:
    """An array of all tiles with the rows of this chunk in it."""
    zero = jnp.zeros_like(chunk.first_tile)
    return lax.dynamic_update_slice(of_tiles, jnp.stack(rows), (zero, chunk.first_tile, zero))


def over_devices(
    kernel: Callable[..., Any], linear: Linearised, out: Any, others: tuple = (), parts: tuple = ()
) -> Any:
    """Runs a kernel on all devices, each with its tiles.

    Args:
        kernel: function of a device's `Linearised` and of `others`.
        out: distribution of its value over the devices, as PartitionSpecs.
        others: further arguments.
        parts: distribution of these arguments; replicated on all devices if empty.
    """
    if linear.problem.devices == 1:
        return kernel(_own(linear, None), *others)
    return jax.shard_map(
        lambda linear, *others: kernel(_own(linear, AXIS), *others),
        mesh=device_mesh(linear.problem.devices),
        in_specs=(linearised_parts(linear), *(parts or everywhere(others))),
        out_specs=out,
        check_vma=False,
    )(linear, *others)


def _own(linear: Linearised, axis: str | None) -> Linearised:
    """The equations of one device: tiles without the leading device axis, which has length 1 there."""
    tiles = tuple(_by_device(t, lambda x: x[0], lambda pair: pair) for t in linear.problem.tiles)
    problem = dataclasses.replace(linear.problem, tiles=tiles)
    return dataclasses.replace(linear, problem=problem, axis=axis)


def everywhere(tree: Any) -> Any:
    """PartitionSpecs of replicated values."""
    return jax.tree.map(lambda _: EVERYWHERE, tree)


def linearised_parts(linear: Linearised) -> Linearised:
    """Distribution of the equations over the devices."""
    parted = [OF_TILES, OF_TILES, problem_parts(linear.problem)]
    parted += [] if linear.point_terms is None else [OF_TILES]

    def own(linear: Linearised) -> list[Any]:
        terms = [] if linear.point_terms is None else [linear.point_terms]
        return [linear.unknowns.tiles, linear.free_tiles, linear.problem, *terms]

    return eqx.tree_at(own, everywhere(linear), parted)


def unknown_parts(unknowns: OrderedUnknowns) -> OrderedUnknowns:
    """Distribution of the unknowns over the devices."""
    return OrderedUnknowns(everywhere(unknowns.images), OF_TILES)


def problem_parts(p: Problem) -> Problem:
    """Distribution of the observations over the devices."""
    tiles = tuple(_by_device(t, lambda _: BY_DEVICE, lambda _: EVERYWHERE) for t in p.tiles)
    return eqx.tree_at(lambda p: p.tiles, everywhere(p), tiles)


def _by_device(tiles: Tiles, own: Callable, common: Callable) -> Tiles:
    """PartitionSpecs: `own` for separate parts of each device, `common` for the list of pairs."""
    mapped = jax.tree.map(own, tiles)
    if tiles.pairs is None:
        return mapped
    return eqx.tree_at(lambda t: t.pairs.pair, mapped, common(tiles.pairs.pair))
