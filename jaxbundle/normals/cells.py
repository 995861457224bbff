"""Cells of a chunk of tiles: rays laid out as a dense grid of image slots by points.

All cell arrays are (slot, column), what belongs to a slot is (slot, 1). What is concatenated is concatenated along the
last axis, which is long: on a CPU that is several times faster than stacking.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry.rotation import Rotation
from jaxbundle.normals.tiles import MOST_TILES


class Tiles(eqx.Module):
    """The tiles of one device, or of all with a leading device axis; `pair` lists the pool's block of every pair of
    slots of every tile, the last block of the pool where two images share no point."""

    slot_image: Int[Array, "*device chunk slot"]
    slot_tile: Int[Array, "*device chunk slot"]
    measured: Float[Array, "*device chunk 2 slot column"]
    weights: Float[Array, "*device chunk 2 slot column"]
    tile_class: Int[Array, "*device chunk"]
    pair_offset: Int[Array, "*device chunk"]
    chunks: Int[Array, "*device"]
    pair: Int[Array, " entry"]


class Chunk(NamedTuple):
    """One chunk: image and tile of every slot (tiles counted from the first), measured values, weights, used cells."""

    slot_image: Int[Array, " slot"]
    first_tile: Int[Array, ""]
    tile: Int[Array, " slot"]
    measured: tuple[Array, Array]
    weights: tuple[Array, Array]
    used: Bool[Array, "slot column"]

    @property
    def tile_count(self) -> Int[Array, ""]:
        """Number of tiles."""
        return self.tile[-1] + 1

    def window(self, of_tiles: Array) -> Array:
        """The chunk's part of an array with a row a tile, with rows of the next chunks behind it."""
        return lax.dynamic_slice_in_dim(of_tiles, self.first_tile, MOST_TILES, 0)


def chunk_of(tiles: Tiles, c: Array) -> Chunk:
    """Chunk number `c`."""
    slot_image, tile, measured, weights = (
        lax.dynamic_index_in_dim(x, c, 0, False)
        for x in (tiles.slot_image, tiles.slot_tile, tiles.measured, tiles.weights)
    )
    used = (weights[0] > 0) | (weights[1] > 0)
    return Chunk(slot_image, tile[0], tile - tile[0], (measured[0], measured[1]), (weights[0], weights[1]), used)


def at_slots(rows: Float[Array, "row number"], index: Int[Array, " slot"]) -> list[Float[Array, "slot 1"]]:
    """Numbers of each slot's image or tile, as columns that broadcast against cells."""
    taken = jnp.take(rows, index, axis=0, mode="clip")
    return [taken[:, k][:, None] for k in range(taken.shape[1])]


def points_at_cells(chunk: Chunk, points: list[Array], tile: Array, rotation: Rotation, centre: Vector) -> Vector:
    """Point of every cell; a cell without ray gets one in front of its camera: its rows are 0, not undefined."""
    ahead = [x - r for x, r in zip(centre, rotation[2::3], strict=True)]
    x, y, z = (
        jnp.where(chunk.used, jnp.take(coordinate, tile, axis=0, mode="clip"), safe)
        for coordinate, safe in zip(points, ahead, strict=True)
    )
    return x, y, z


def sum_by_tile(cells: list[Array], tile: Int[Array, " slot"]) -> list[Array]:
    """Sums of several cell arrays over the slots of every tile: (tile, column) each."""
    n = cells[0].shape[1]
    joined = jnp.concatenate(lax.optimization_barrier(cells), 1)
    sums = (
        jnp.zeros((MOST_TILES, joined.shape[1])).at[tile].add(joined, mode="promise_in_bounds", indices_are_sorted=True)
    )
    return [sums[:, k * n : (k + 1) * n] for k in range(len(cells))]
