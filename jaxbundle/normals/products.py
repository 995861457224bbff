"""Products of a tile's E: with itself, E E^T into the pool, and with blocks of the pool, (T + T^T) E.

Which block of the pool belongs to a pair of slots is looked up in lists the host has made. Tiles of a few slots are
multiplied in one piece, with a loop for every size; those of long tracks in groups of slots against groups of slots,
below the diagonal only, so that no temporary is larger than a pair of groups, whatever the size of the tile.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.normals.tiles import CLASSES, SLOTS, Tiling
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size

DENSE_TABLE = 4096  # images; beyond, pairs are looked up by bisection

Finder = Callable[[Any, Any], Any]


class AbstractProducts(eqx.Module):
    """The products of the chunks of one device, or of all with a leading device axis.

    `pair`: the pool's block of pairs of slots, the last block of the pool where two images share no point. `coupling`
    is E of a chunk, a row a slot: by unknown, coordinate, column.
    """

    pair: eqx.AbstractVar[Int[Array, " entry"]]

    @abc.abstractmethod
    def added(
        self, pool: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "pair d d"]:
        """The pool with E E^T of all `tiles` tiles of chunk `c` added."""

    @abc.abstractmethod
    def applied(
        self, lower: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "slot number"]:
        """(T + T^T) E of all tiles of chunk `c`, tile by tile, for a T that the pool `lower` holds."""


class ClassProducts(AbstractProducts):
    """Chunks of tiles of one size: `tile_class`, an index into CLASSES; `pair_offset`, where a chunk's pairs begin."""

    tile_class: Int[Array, "*device chunk"]
    pair_offset: Int[Array, "*device chunk"]
    pair: Int[Array, " entry"]

    def added(
        self, pool: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "pair d d"]:
        """One loop a class, of which one turns."""
        kind, offset = (lax.dynamic_index_in_dim(x, c, 0, False) for x in (self.tile_class, self.pair_offset))
        d = pool.shape[1]

        def add_tiles(size: int):
            def add(t: Array, pool: Array) -> Array:
                # the factor must depend on the turn, else the product is hoisted out of the loop, done for every class
                e = lax.dynamic_slice_in_dim(coupling, t * size, size, 0) if size < SLOTS else coupling * (1 + t)
                e = e.reshape(size * d, -1)
                block = lax.dynamic_slice_in_dim(self.pair, offset + t * size * size, size * size, 0)
                return pool.at[block].add(_blocks(e, e, size, d), mode="promise_in_bounds")

            return add

        for k, size in enumerate(CLASSES):
            pool = lax.fori_loop(0, jnp.where(kind == k, tiles, 0), add_tiles(size), pool)
        return pool

    def applied(
        self, lower: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "slot number"]:
        """One loop a class, of which one turns."""
        kind, offset = (lax.dynamic_index_in_dim(x, c, 0, False) for x in (self.tile_class, self.pair_offset))
        d = lower.shape[1]

        def of_tiles(size: int):
            def one(t: Array, store: Array) -> Array:
                e = lax.dynamic_slice_in_dim(coupling, t * size, size, 0).reshape(size * d, -1)
                block = lax.dynamic_slice_in_dim(self.pair, offset + t * size * size, size * size, 0)
                matrix = _matrix(jnp.take(lower, block, axis=0, mode="clip"), size)
                product = (matrix + matrix.T) @ e
                return lax.dynamic_update_slice_in_dim(store, product.reshape(size, -1), t * size, 0)

            return one

        store = jnp.zeros_like(coupling)
        for k, size in enumerate(CLASSES):
            store = lax.fori_loop(0, jnp.where(kind == k, tiles, 0), of_tiles(size), store)
        return store


class GroupProducts(AbstractProducts):
    """Chunks with `count` products from `first` on, of the slots from `row` on with those from `column` on.

    `tile`: within the chunk. `pairs`: where in `pair` the blocks of a product begin; tiles of the same images share
    them. `group`: slots multiplied at once. `most_tiles`: a chunk's.
    """

    first: Int[Array, "*device chunk"]
    count: Int[Array, "*device chunk"]
    row: Int[Array, "*device product"]
    column: Int[Array, "*device product"]
    tile: Int[Array, "*device product"]
    pairs: Int[Array, "*device product"]
    pair: Int[Array, " entry"]
    group: int = eqx.field(static=True)
    most_tiles: int = eqx.field(static=True)

    def added(
        self, pool: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "pair d d"]:
        """One product after the other."""
        d = pool.shape[1]

        def add(p: Array, pool: Array) -> Array:
            left, right, block = self._operands(coupling, p, d)
            return pool.at[block].add(_blocks(left, right, self.group, d), mode="promise_in_bounds")

        first = self.first[c]
        return lax.fori_loop(first, first + self.count[c], add, pool)

    def applied(
        self, lower: Float[Array, "pair d d"], coupling: Float[Array, "slot number"], c: Array, tiles: Array
    ) -> Float[Array, "slot number"]:
        """One product after the other, each used for its own rows and, transposed, for its columns."""
        d = lower.shape[1]

        def add(p: Array, store: Array) -> Array:
            left, right, block = self._operands(coupling, p, d)
            matrix = _matrix(jnp.take(lower, block, axis=0, mode="clip"), self.group)
            for start, product in ((self.row[p], matrix @ right), (self.column[p], matrix.T @ left)):
                own = lax.dynamic_slice_in_dim(store, start, self.group, 0)
                store = lax.dynamic_update_slice_in_dim(store, own + product.reshape(self.group, -1), start, 0)
            return store

        first = self.first[c]
        return lax.fori_loop(first, first + self.count[c], add, jnp.zeros_like(coupling))

    def _operands(self, coupling: Array, p: Array, d: int) -> tuple[Array, Array, Array]:
        """Both groups of rows of a product, and the blocks of their pairs."""
        left, right = (
            lax.dynamic_slice_in_dim(coupling, start[p], self.group, 0).reshape(self.group * d, -1)
            for start in (self.row, self.column)
        )
        return left, right, lax.dynamic_slice_in_dim(self.pair, self.pairs[p], self.group**2, 0)


def _blocks(left: Float[Array, "row k"], right: Float[Array, "row k"], slots: int, d: int) -> Float[Array, "pair d d"]:
    """E E^T of some slots with as many, as blocks of their pairs."""
    product = lax.dot_general(left, right, (((1,), (1,)), ((), ())))
    return product.reshape(slots, d, slots, d).transpose(0, 2, 1, 3).reshape(slots * slots, d, d)


def _matrix(blocks: Float[Array, "pair d d"], slots: int) -> Float[Array, "row row"]:
    """T of some slots by as many, in one piece."""
    d = blocks.shape[1]
    return blocks.reshape(slots, slots, d, d).transpose(0, 2, 1, 3).reshape(slots * d, slots * d)


def contracted(
    left: Float[Array, "entity row 3 n"], right: Float[Array, "entity row 3 n"]
) -> Float[Array, "entity 3 3 n"]:
    """Sum over the rows of the products of every pair of coordinates, point by point."""
    return jnp.stack([jnp.sum(left[:, :, k, None] * right, 1) for k in range(3)], 1)


def pair_finder(pairs: Int[np.ndarray, "pair 2"], images: int, waste: int) -> Finder:
    """Function from two ranks to the block of their pair; `waste` where i < j or where they share no point."""
    if images <= DENSE_TABLE:
        table = np.full((images, images), waste, np.int32)
        table[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
        return lambda i, j: table[i, j]
    code = pairs[:, 0] * np.int64(images) + pairs[:, 1]

    def find(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        wanted = i * np.int64(images) + j
        at = np.minimum(np.searchsorted(code, wanted), len(code) - 1)
        return np.where(code[at] == wanted, at, waste)

    return find


def class_products(plan: Tiling, find: Finder, waste: int) -> ClassProducts:
    """The pool's block of every pair of slots of every tile, chunk after chunk of a class."""
    shape = plan.slot_image.shape[:2]
    size = np.zeros(shape, np.int64)
    size[plan.tile_slots[:, 0], plan.tile_slots[:, 1]] = plan.tile_slots[:, 3]
    offset = np.zeros(shape, np.int64)
    lists, total = [], 0
    for slots in CLASSES:
        g, c = np.nonzero(size == slots)
        if len(g) == 0:
            continue
        image = plan.slot_image[g, c].reshape(-1, slots)
        offset[g, c] = total + np.arange(len(g)) * SLOTS * slots
        total += len(g) * SLOTS * slots
        lists.append(find(image[:, :, None], image[:, None, :]).ravel())
    pad = grid_size(total + SLOTS * SLOTS) - total  # a chunk may read on beyond its last tile
    pair = np.concatenate([*lists, np.full(pad, waste)])
    kind = np.where(size > 0, np.searchsorted(CLASSES, size), 0)
    kind, offset, pair = (on_device(x, jnp.int32) for x in (kind, offset, pair))
    return ClassProducts(kind, offset, pair)


def group_products(plan: Tiling, find: Finder, waste: int) -> GroupProducts:
    """The products of every tile's groups of slots, chunk after chunk, and the blocks of all different ones."""
    devices, chunks, slots = plan.slot_image.shape
    group, in_order = plan.group, np.lexsort(plan.tile_slots[:, 2::-1].T)
    device, chunk, slot, size = plan.tile_slots[in_order].T
    groups = size // group
    products = groups * (groups + 1) // 2
    # row by row of the lower triangle: the products of a smaller tile come first
    row, column = np.tril_indices(groups.max())
    tile = np.repeat(np.arange(len(products)), products)
    k = np.arange(len(tile)) - np.repeat(np.cumsum(products) - products, products)
    row, column, device, chunk = row[k], column[k], device[tile], chunk[tile]

    images, number = np.unique(plan.slot_image.reshape(-1, group), axis=0, return_inverse=True)
    number = number.reshape(devices, chunks, -1)
    first_group = slot[tile] // group
    code = number[device, chunk, first_group + row] * len(images) + number[device, chunk, first_group + column]
    different, pairs = np.unique(code, return_inverse=True)
    i, j = images[different // len(images)], images[different % len(images)]
    block = find(i[:, :, None], j[:, None, :]).ravel()

    count = np.bincount(device * chunks + chunk, minlength=devices * chunks).reshape(devices, chunks)
    of_device = np.arange(len(tile)) - np.searchsorted(device, device)
    padded = np.zeros((4, devices, grid_size(int(count.sum(1).max()))), np.int32)
    within = plan.slot_tile[device, chunk, slot[tile]] - plan.slot_tile[device, chunk, 0]
    padded[:, device, of_device] = slot[tile] + group * row, slot[tile] + group * column, within, pairs * group**2
    pair = np.concatenate([block, np.full((grid_size(len(different)) - len(different)) * group**2, waste)])
    first, count, pair = (on_device(x, jnp.int32) for x in (np.cumsum(count, 1) - count, count, pair))
    row, column, tile, pairs = (on_device(x) for x in padded)
    return GroupProducts(first, count, row, column, tile, pairs, pair, group, plan.most_tiles)
