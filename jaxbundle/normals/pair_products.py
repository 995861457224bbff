"""Products of a tile's E with itself, E E^T, added to blocks of image pairs, and with such blocks, (T + T^T) E.

The lists of the plan (`plan.pair_lists`) contain the block of each pair of slots. `coupling` is E of a
chunk, one row per slot: by unknown, coordinate, column.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.normals.plan.pair_lists import ClassPairs, GroupPairs
from jaxbundle.normals.plan.tiling import CLASSES, SLOTS
from jaxbundle.normals.problem import Tiles

Blocks = Float[Array, "pair d d"]
Coupling = Float[Array, "slot number"]


def add_tile_products(blocks: Blocks, part: Tiles, coupling: Coupling, c: Array, tiles: Array) -> Blocks:
    """Adds E E^T of all `tiles` tiles of chunk `c` to the blocks."""
    if isinstance(part.pairs, GroupPairs):
        return _add_by_groups(blocks, part.pairs, part.group, coupling, c)
    assert part.pairs is not None
    return _add_by_class(blocks, part.pairs, coupling, c, tiles)


def apply_blocks(lower: Blocks, part: Tiles, coupling: Coupling, c: Array, tiles: Array) -> Coupling:
    """The product (T + T^T) E of all tiles of chunk `c`, for a T with the blocks `lower`."""
    if isinstance(part.pairs, GroupPairs):
        return _apply_by_groups(lower, part.pairs, part.group, coupling, c)
    assert part.pairs is not None
    return _apply_by_class(lower, part.pairs, coupling, c, tiles)


def _add_by_class(blocks: Blocks, pairs: ClassPairs, coupling: Coupling, c: Array, tiles: Array) -> Blocks:
    """One loop per class; only one has iterations."""
    kind, offset = (lax.dynamic_index_in_dim(x, c, 0, False) for x in (pairs.tile_class, pairs.pair_offset))
    d = blocks.shape[1]

    def add_tiles(size: int):
        def add(t: Array, blocks: Array) -> Array:
            # the factor must depend on the iteration, otherwise the product is moved out of the loop and done for all
            # classes
            e = (
                lax.dynamic_slice_in_dim(coupling, t * size, size, 0)
                if size < SLOTS
                else coupling * (1 + t).astype(coupling.dtype)
            )
            e = e.reshape(size * d, -1)
            block = lax.dynamic_slice_in_dim(pairs.pair, offset + t * size * size, size * size, 0)
            return blocks.at[block].add(_blocks(e, e, size, d), mode="promise_in_bounds")

        return add

    for k, size in enumerate(CLASSES):
        blocks = lax.fori_loop(0, jnp.where(kind == k, tiles, 0), add_tiles(size), blocks)
    return blocks


def _apply_by_class(lower: Blocks, pairs: ClassPairs, coupling: Coupling, c: Array, tiles: Array) -> Coupling:
    """One loop per class; only one has iterations."""
    kind, offset = (lax.dynamic_index_in_dim(x, c, 0, False) for x in (pairs.tile_class, pairs.pair_offset))
    d = lower.shape[1]

    def of_tiles(size: int):
        def one(t: Array, out: Array) -> Array:
            e = lax.dynamic_slice_in_dim(coupling, t * size, size, 0).reshape(size * d, -1)
            block = lax.dynamic_slice_in_dim(pairs.pair, offset + t * size * size, size * size, 0)
            matrix = _matrix(jnp.take(lower, block, axis=0, mode="clip"), size)
            product = (matrix + matrix.T) @ e
            return lax.dynamic_update_slice_in_dim(out, product.reshape(size, -1), t * size, 0)

        return one

    out = jnp.zeros_like(coupling)
    for k, size in enumerate(CLASSES):
        out = lax.fori_loop(0, jnp.where(kind == k, tiles, 0), of_tiles(size), out)
    return out


def _add_by_groups(blocks: Blocks, pairs: GroupPairs, group: int, coupling: Coupling, c: Array) -> Blocks:
    """Computes the products of two groups of slots one after the other."""
    d = blocks.shape[1]

    def add(k: Array, blocks: Array) -> Array:
        left, right, block = _operands(pairs, group, coupling, k, d)
        return blocks.at[block].add(_blocks(left, right, group, d), mode="promise_in_bounds")

    first = pairs.first[c]
    return lax.fori_loop(first, first + pairs.count[c], add, blocks)


def _apply_by_groups(lower: Blocks, pairs: GroupPairs, group: int, coupling: Coupling, c: Array) -> Coupling:
    """Computes one product after the other; each is used for its rows and, transposed, for its columns."""
    d = lower.shape[1]

    def add(k: Array, out: Array) -> Array:
        left, right, block = _operands(pairs, group, coupling, k, d)
        matrix = _matrix(jnp.take(lower, block, axis=0, mode="clip"), group)
        for start, product in ((pairs.row[k], matrix @ right), (pairs.column[k], matrix.T @ left)):
            own = lax.dynamic_slice_in_dim(out, start, group, 0)
            out = lax.dynamic_update_slice_in_dim(out, own + product.reshape(group, -1), start, 0)
        return out

    first = pairs.first[c]
    return lax.fori_loop(first, first + pairs.count[c], add, jnp.zeros_like(coupling))


def _operands(
    pairs: GroupPairs, group: int, coupling: Coupling, k: Array, d: int
) -> tuple[Array, Array, Int[Array, " pair"]]:
    """Both groups of rows of a product, and the blocks of their pairs."""
    left, right = (
        lax.dynamic_slice_in_dim(coupling, start[k], group, 0).reshape(group * d, -1)
        for start in (pairs.row, pairs.column)
    )
    return left, right, lax.dynamic_slice_in_dim(pairs.pair, pairs.pairs[k], group**2, 0)


def _blocks(left: Float[Array, "row k"], right: Float[Array, "row k"], slots: int, d: int) -> Blocks:
    """The product E E^T of two equal groups of slots, as blocks of their pairs."""
    product = lax.dot_general(left, right, (((1,), (1,)), ((), ())))
    return product.reshape(slots, d, slots, d).transpose(0, 2, 1, 3).reshape(slots * slots, d, d)


def _matrix(blocks: Blocks, slots: int) -> Float[Array, "row row"]:
    """The matrix T of two equal groups of slots, as one array."""
    d = blocks.shape[1]
    return blocks.reshape(slots, slots, d, d).transpose(0, 2, 1, 3).reshape(slots * d, slots * d)
