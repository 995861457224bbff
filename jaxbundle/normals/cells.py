"""Cells of a chunk of tiles: rays laid out as a dense grid of image slots by points.

All cell arrays are (slot, column), what belongs to a slot is (slot, 1). What is concatenated is concatenated along the
last axis, which is long: on a CPU that is several times faster than stacking.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry.rotation import Rotation
from jaxbundle.normals.products import AbstractProducts
from jaxbundle.numerics.host import is_concrete
from jaxbundle.numerics.stored import stored


def to_cells(values: Any, cell: Int[np.ndarray, "device chunk slot column"], rays: Int[np.ndarray, " of_part"]) -> Any:
    """A number of every ray at its cell, 0 where there is none; `cell`: which of the part's `rays` it has, or -1."""
    if is_concrete(values):
        return np.append(values[rays], 0.0)[cell]
    return _to_cells(values, np.append(rays, len(values))[cell])


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _to_cells(values: Array, ray: Int[np.ndarray, "device chunk slot column"]) -> Array:
    return jnp.append(values, 0.0)[ray]


@_to_cells.defjvp
def _to_cells_jvp(ray: np.ndarray, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # written as a scatter, because the transposed one of that is a gather, which is cheap
    flat, place = ray.ravel(), np.full(len(primals[0]), ray.size)
    used = np.flatnonzero(flat < len(place))
    place[flat[used]] = used
    put = jnp.zeros(ray.size).at[place].set(tangents[0], mode="drop", unique_indices=True)
    return _to_cells(primals[0], ray), put.reshape(ray.shape)


class Tiles(eqx.Module):
    """The tiles of one device, or of all with a leading device axis; without products where no pool takes them.

    `most_tiles`: a chunk's. `group`: so many neighbouring slots from a multiple of it on belong to one tile.
    """

    slot_image: Int[Array, "*device chunk slot"]
    slot_tile: Int[Array, "*device chunk slot"]
    measured: Float[Array, "*device chunk 2 slot column"]
    weights: Float[Array, "*device chunk 2 slot column"]
    chunks: Int[Array, "*device"]
    products: AbstractProducts | None
    most_tiles: int = eqx.field(static=True)
    group: int = eqx.field(static=True)


class Chunk(NamedTuple):
    """One chunk: image and tile of every slot (tiles counted from the first), measured values, weights, used cells.

    `most_tiles`: of any chunk.
    """

    slot_image: Int[Array, " slot"]
    first_tile: Int[Array, ""]
    tile: Int[Array, " slot"]
    measured: tuple[Array, Array]
    weights: tuple[Array, Array]
    used: Bool[Array, "slot column"]
    most_tiles: int

    @property
    def tile_count(self) -> Int[Array, ""]:
        """Number of tiles."""
        return self.tile[-1] + 1

    @property
    def zero(self) -> Int[Array, ""]:
        """A 0 that only the running program knows; see `stored`."""
        return jnp.minimum(self.first_tile, 0)

    def window(self, of_tiles: Array) -> Array:
        """The chunk's part of an array with a row a tile, with rows of the next chunks behind it."""
        return lax.dynamic_slice_in_dim(of_tiles, self.first_tile, self.most_tiles, 0)


def chunk_of(tiles: Tiles, c: Array) -> Chunk:
    """Chunk number `c`."""
    slot_image, tile, measured, weights = (
        lax.dynamic_index_in_dim(x, c, 0, False)
        for x in (tiles.slot_image, tiles.slot_tile, tiles.measured, tiles.weights)
    )
    used = (weights[0] > 0) | (weights[1] > 0)
    measured, weights = (measured[0], measured[1]), (weights[0], weights[1])
    return Chunk(slot_image, tile[0], tile - tile[0], measured, weights, used, tiles.most_tiles)


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


def sum_by_tile(cells: list[Array], chunk: Chunk) -> list[Array]:
    """Sums of several cell arrays over the slots of every tile: (tile, column) each."""
    n = cells[0].shape[1]
    joined = jnp.concatenate(stored(cells, chunk.zero), 1)
    zero = jnp.zeros((chunk.most_tiles, joined.shape[1]))
    sums = zero.at[chunk.tile].add(joined, mode="promise_in_bounds", indices_are_sorted=True)
    return [sums[:, k * n : (k + 1) * n] for k in range(len(cells))]
