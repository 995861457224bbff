"""Lists of the blocks of image pairs for all pairs of slots of a tile, for the products of E.

Tiles of a few slots are multiplied in one piece, with a loop for each size; tiles of long tracks by pairs of groups
of slots, only below the diagonal, so that temporary arrays are limited to a pair of groups.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from jaxbundle.normals.plan.tiling import CLASSES, SLOTS, Tiling
from jaxbundle.numerics.shapes import grid_size

DENSE_TABLE = 4096  # number of images above which pairs are looked up by bisection

FEWEST_ENTRIES = 8192  # padded number of pairs of slots: small blocks share a program

Finder = Callable[[Any, Any], Any]


class ClassPairs(NamedTuple):
    """Chunks of tiles of one size; numpy arrays in the plan, JAX arrays in a program."""

    tile_class: Int[Any, "*device chunk"]
    """Index into CLASSES."""
    pair_offset: Int[Any, "*device chunk"]
    """Start of the pairs of a chunk."""
    pair: Int[Any, " entry"]
    """Block of each pair of slots; the last block for two images without common points. Common to all devices."""


class GroupPairs(NamedTuple):
    """Chunks of tiles of any size, multiplied by groups of slots."""

    first: Int[Any, "*device chunk"]
    """Start of the products of a chunk."""
    count: Int[Any, "*device chunk"]
    """Number of products of a chunk."""
    row: Int[Any, "*device product"]
    """First slot of the left group."""
    column: Int[Any, "*device product"]
    """First slot of the right group."""
    pairs: Int[Any, "*device product"]
    """Start of the blocks of a product in `pair`; tiles with the same images share them."""
    pair: Int[Any, " entry"]
    """Block of each pair of slots; the last block for two images without common points. Common to all devices."""


def pair_finder(pairs: Int[np.ndarray, "pair 2"], images: int, waste: int) -> Finder:
    """Function from two ranks to the block of their pair; `waste` for i < j or without common points."""
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


def class_pairs(plan: Tiling, find: Finder, waste: int) -> ClassPairs:
    """The blocks of all pairs of slots of all tiles, chunk after chunk of a class."""
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
    pad = grid_size(total + SLOTS * SLOTS, FEWEST_ENTRIES) - total  # a chunk may read beyond its last tile
    pair = np.concatenate([*lists, np.full(pad, waste)])
    kind = np.where(size > 0, np.searchsorted(CLASSES, size), 0)
    return ClassPairs(*(x.astype(np.int32) for x in (kind, offset, pair)))


def group_pairs(plan: Tiling, find: Finder, waste: int) -> GroupPairs:
    """The products of the groups of slots of all tiles, chunk after chunk, and the blocks of all different ones."""
    devices, chunks, _ = plan.slot_image.shape
    group, in_order = plan.group, np.lexsort(plan.tile_slots[:, 2::-1].T)
    device, chunk, slot, size = plan.tile_slots[in_order].T
    groups = size // group
    products = groups * (groups + 1) // 2
    # row by row of the lower triangle: the products of a smaller tile are the first ones
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
    padded = np.zeros((3, devices, grid_size(int(count.sum(1).max()))), np.int32)
    padded[:, device, of_device] = slot[tile] + group * row, slot[tile] + group * column, pairs * group**2
    pair = np.concatenate([block, np.full((grid_size(len(different)) - len(different)) * group**2, waste)])
    return GroupPairs(*(x.astype(np.int32) for x in (np.cumsum(count, 1) - count, count, *padded, pair)))
