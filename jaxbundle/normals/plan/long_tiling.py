"""Host plan of the tiles of points with long tracks: more images than a chunk of ordinary tiles has slots.

    chunk    32 T slots x width cells, T large enough for the widest tile
    tile     g groups of 32 slots; its product E E^T is formed group by group, g (g + 1) / 2 times
    cell     one ray, as in ordinary tiles

Tiles of any size stand in one chunk behind each other, so that a single point on a thousand images does not make the
tiles of all others as large. Points are joined to a tile where that makes fewer products than leaving them apart.
"""

import numpy as np
from jaxtyping import Int

from jaxbundle.normals.plan.tiling import SLOTS, Places, Seen, Tiling, laid_out, number_images, positions_along_curve
from jaxbundle.numerics.shapes import grid_size

GROUP = 32  # slots; a product is then large enough to be fast, and its temporaries stay in the cache
FEWEST_GROUPS = SLOTS // GROUP + 1  # of a point with a long track


def padded_groups(groups: int) -> int:
    """Groups a chunk: few different numbers, a quarter more than needed at most."""
    step = 2 ** max(0, groups.bit_length() - 3)
    return -(-groups // step) * step


def _products(images: Int[np.ndarray, " tile"]) -> Int[np.ndarray, " tile"]:
    """Products of groups with groups, for tiles with so many images."""
    groups = -(-images // GROUP)
    return groups * (groups + 1) // 2


def _joined(position: Int[np.ndarray, " ray"], seen: Seen, width: int) -> Int[np.ndarray, " position"]:
    """Tile of every position along the curve: rows of `width`, halved again and again where that saves products."""
    points = seen.points
    tile = np.arange(points)
    fewest = _products(np.bincount(position, minlength=points))
    size = 1
    while size < width:
        size *= 2
        row = np.arange(points) // size
        apart = np.add.reduceat(fewest, np.arange(0, len(fewest), 2))
        joined = _products(number_images(position // size, seen.image, seen.images, len(apart)).counts)
        fewest = np.minimum(joined, apart)
        tile = np.where((joined <= apart)[row], row * size, tile)
    return np.unique(tile, return_inverse=True)[1]


def _packed(groups: Int[np.ndarray, " tile"], capacity: int, devices: int) -> Places:
    """Tiles laid into chunks of `capacity` groups, the largest first, and the chunks dealt to the devices in turn."""
    order = np.argsort(-groups, kind="stable")
    chunk, slot = np.empty((2, len(groups)), np.int64)
    last, used = -1, capacity
    for t in order:
        if used + groups[t] > capacity:
            last, used = last + 1, 0
        chunk[t], slot[t] = last, used * GROUP
        used += groups[t]
    device, chunk = chunk % devices, chunk // devices
    number = np.empty(len(groups), np.int64)
    for g in range(devices):
        mine = order[device[order] == g]
        number[mine] = np.arange(len(mine))
    chunks = (last + devices - np.arange(devices)) // devices
    return Places(np.stack([device, chunk, slot, groups * GROUP], 1), number, chunks.astype(np.int32))


def long_tiling(seen: Seen, devices: int, width: int) -> Tiling:
    """Tiles of points that have more than SLOTS rays each."""
    position = positions_along_curve(seen)
    tile = _joined(position[seen.point], seen, width)
    entries = number_images(tile[position[seen.point]], seen.image, seen.images, int(tile[-1]) + 1)
    groups = -(-entries.counts // GROUP)
    capacity = padded_groups(int(groups.max()))
    places = _packed(groups, capacity, devices)
    shape = devices, grid_size(int(places.chunks.max()), 4), capacity * GROUP
    max_tiles = capacity // FEWEST_GROUPS
    return laid_out(seen, tile, position, entries, places, shape=shape, width=width, max_tiles=max_tiles, group=GROUP)
