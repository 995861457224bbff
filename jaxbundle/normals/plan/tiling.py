"""Host plan of the tiles: object points sorted so that neighbours are seen by the same images.

A tile is a dense grid of `width` points by the images that see any of them; a grid cell without ray has weight 0. A
chunk is a row of tiles of one class (number of images, rounded up) with SLOTS image slots in all, so all chunks have
the same shape and their element-wise operations are compiled once, for any tracks:

    chunk    SLOTS x width cells, SLOTS // K tiles of class K
    cell     one ray: image slot s, column j -> ray[chunk, s, j], or -1

Points are sorted along a space-filling curve through the bounding boxes of the projection centres that see them (Morton
code of the box's four sides): points with equal boxes have nearly equal tracks. Points with long tracks, on more images
than a chunk has slots, have separate chunks:

    chunk    32 T slots x width cells, T large enough for the widest tile
    tile     g groups of 32 slots; its product E E^T is formed group by group, g (g + 1) / 2 times

There tiles of different size follow each other, so that a single point on a thousand images does not enlarge the tiles
of all others. Points are joined to a tile if this needs fewer products than separate tiles.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from jaxbundle.numerics.shapes import grid_size

SLOTS = 48
CLASSES = (2, 3, 4, 6, 8, 12, 16, 24, 48)  # classes: divisors of SLOTS
MAX_TILES = SLOTS // CLASSES[0]  # image slots of a chunk
FEWEST_TILES = 64  # padded number: small blocks share a program
CUTS = 4  # number of positions where a tile may be split, at a jump of the curve
MORTON_BITS = 12
CELLS_AT_ONCE = 200_000_000  # limits the memory of the table of tiles and images
GROUP = 32  # slots; a product is then large enough to be fast, and its temporaries stay in the cache
FEWEST_GROUPS = SLOTS // GROUP + 1  # of a point with a long track


class Seen(NamedTuple):
    """Rays sorted by point: images, points, number of points, and projection centres, in elimination order."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    points: int
    centres: Float[np.ndarray, "image 3"]

    @property
    def images(self) -> int:
        """Number of images of the block."""
        return len(self.centres)


@dataclass(frozen=True)
class Tiling:
    """Tiles of some points. All devices have the same numbers of chunks and tiles; the last tile is empty."""

    point_tile: Int[np.ndarray, "point 3"]
    """Device, tile and column of each point."""
    tile_slots: Int[np.ndarray, "tile 4"]
    """Device, chunk, first slot and number of slots of each tile."""
    slot_image: Int[np.ndarray, "device chunk slot"]
    """Rank of the image; the number of images for an empty slot."""
    slot_tile: Int[np.ndarray, "device chunk slot"]
    """Tile within the device."""
    ray: Int[np.ndarray, "device chunk slot width"]
    """Ray of each cell, -1 where there is none."""
    chunks: Int[np.ndarray, " device"]
    """Number of used chunks."""
    tiles: int
    """Padded number of tiles of a device."""
    max_tiles: int
    """Maximum number of tiles of a chunk."""
    group: int
    """Size of the groups of neighbouring slots that belong to one tile."""


def tile_width(rays: int) -> int:
    """Points per tile: wide tiles have faster matrix products, narrow ones waste fewer cells in a small block."""
    return 32 if rays > 200_000 else 16


def _spread(values: Int[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Spreads the bits of small integers to every fourth position."""
    table = np.zeros(256, np.uint64)
    for bit in range(8):
        table |= ((np.arange(256, dtype=np.uint64) >> np.uint64(bit)) & np.uint64(1)) << np.uint64(4 * bit)
    low, high = values & 255, values >> 8
    return table[low] | table[high] << np.uint64(32)


def positions_along_curve(seen: Seen) -> Int[np.ndarray, " point"]:
    """Position of each point along the curve."""
    first = np.searchsorted(seen.point, np.arange(seen.points))
    centred = seen.centres - seen.centres.mean(0)
    axes = np.linalg.svd(centred.T @ centred)[2][:2]
    plane = centred @ axes.T
    low, high = plane.min(0), plane.max(0)
    steps = ((plane - low) / (high - low + np.finfo(float).tiny) * (2**MORTON_BITS - 1)).astype(np.int32)
    code = np.zeros(seen.points, np.uint64)
    for axis in range(2):
        of_ray = steps[seen.image, axis]
        code |= _spread(np.minimum.reduceat(of_ray, first)) << np.uint64(axis)
        code |= _spread(np.maximum.reduceat(of_ray, first)) << np.uint64(2 + axis)
    position = np.empty(seen.points, np.int64)
    position[np.argsort(code, kind="stable")] = np.arange(seen.points)
    return position


def _cut(position: Int[np.ndarray, " ray"], seen: Seen, width: int) -> Int[np.ndarray, " point"]:
    """Tile of each position along the curve; a row of `width` points is split if that is cheaper."""
    image, images, points = seen.image, seen.images, seen.points
    part_width = width // CUTS
    rows = -(-points // width)
    where = np.zeros(rows, np.int64)
    at_once = max(1, CELLS_AT_ONCE // (CUTS * images))
    for start in range(0, rows, at_once):
        count = min(at_once, rows - start)
        inside = slice(None) if count == rows else (position // width >= start) & (position // width < start + count)
        sees = np.zeros((count * CUTS, images), bool)
        sees[position[inside] // part_width - start * CUTS, image[inside]] = True
        where[start : start + count] = _best_cut(sees.reshape(count, CUTS, images))
    row = np.arange(points) // width
    second = (where[row] > 0) & (np.arange(points) % width >= where[row] * part_width)
    return row + np.cumsum(where > 0)[row] - (where[row] > 0) + second


def _best_cut(seen: Bool[np.ndarray, "row part image"]) -> Int[np.ndarray, " row"]:
    """Part before which each row is split, 0 for no split; the work is proportional to images^2."""
    best, at = seen.any(1).sum(1).astype(float) ** 2, np.zeros(len(seen), np.int64)
    for cut in range(1, CUTS):
        left, right = seen[:, :cut].any(1).sum(1), seen[:, cut:].any(1).sum(1)
        halves = left.astype(float) ** 2 + right.astype(float) ** 2 + 2.0 * (left + right)
        better = halves < 0.9 * best
        best[better], at[better] = halves[better], cut
    return at


def _columns(tile: Int[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """Column of each point within its tile."""
    return np.arange(len(tile)) - np.searchsorted(tile, tile)


class Entries(NamedTuple):
    """Tile and image of each pair with a ray, index of each ray's image in its tile, images per tile."""

    tile: Int[np.ndarray, " entry"]
    image: Int[np.ndarray, " entry"]
    number: Int[np.ndarray, " ray"]
    counts: Int[np.ndarray, " tile"]


def number_images(tile: Int[np.ndarray, " ray"], image: Int[np.ndarray, " ray"], images: int, tiles: int) -> Entries:
    """The numbered images of each tile."""
    of_ray = np.empty(len(tile), np.int32)
    entries = []
    counts = np.empty(tiles, np.int64)
    at_once = max(1, CELLS_AT_ONCE // (4 * images))
    for start in range(0, tiles, at_once):
        count = min(at_once, tiles - start)
        inside = slice(None) if count == tiles else np.nonzero((tile >= start) & (tile < start + count))[0]
        seen = np.zeros((count, images), bool)
        seen[tile[inside] - start, image[inside]] = True
        number = np.cumsum(seen, 1, dtype=np.int32)
        of_ray[inside] = number[tile[inside] - start, image[inside]] - 1
        counts[start : start + count] = number[:, -1]
        t, i = np.nonzero(seen)
        entries.append((t + start, i))
    return Entries(np.concatenate([t for t, _ in entries]), np.concatenate([i for _, i in entries]), of_ray, counts)


class Places(NamedTuple):
    """Position of each tile: device, chunk, first slot and slots; its number on the device; chunks of the devices."""

    tile_slots: Int[np.ndarray, "tile 4"]
    number: Int[np.ndarray, " tile"]
    chunks: Int[np.ndarray, " device"]


def _deal(kinds: Int[np.ndarray, " tile"], devices: int) -> Places:
    """Makes chunks of one class each, distributed equally over the devices."""
    tile_slots, number = np.empty((len(kinds), 4), np.int64), np.empty(len(kinds), np.int64)
    used, dealt_chunks = [0] * devices, [0] * devices
    for kind, size in enumerate(CLASSES):
        tiles = np.nonzero(kinds == kind)[0]
        per_chunk = SLOTS // size
        chunks = -(-len(tiles) // per_chunk)
        # the device with the fewest chunks so far gets the odd one
        order = sorted(range(devices), key=lambda g: dealt_chunks[g])
        first = 0
        for turn, g in enumerate(order):
            mine = chunks // devices + (turn < chunks % devices)
            dealt = tiles[first * per_chunk : (first + mine) * per_chunk]
            first += mine
            k = np.arange(len(dealt))
            chunk, slot = dealt_chunks[g] + k // per_chunk, k % per_chunk * size
            tile_slots[dealt] = np.stack([np.full_like(k, g), chunk, slot, np.full_like(k, size)], 1)
            number[dealt] = used[g] + k
            used[g] += len(dealt)
            dealt_chunks[g] += mine
    return Places(tile_slots, number, np.array(dealt_chunks, np.int32))


def laid_out(
    seen: Seen,
    tile: Int[np.ndarray, " position"],
    position: Int[np.ndarray, " point"],
    entries: Entries,
    places: Places,
    *,
    shape: tuple[int, int, int],
    width: int,
    max_tiles: int,
    group: int,
) -> Tiling:
    """Slots and cells of all tiles; `tile`: of each position along the curve, `shape`: devices, chunks and slots."""
    device, chunk, slot, size = places.tile_slots.T
    first = (device * shape[1] + chunk) * shape[2] + slot
    slot_image = np.full(shape, seen.images, np.int32)
    number = np.arange(len(entries.tile)) - np.repeat(np.cumsum(entries.counts) - entries.counts, entries.counts)
    slot_image.ravel()[first[entries.tile] + number] = entries.image
    slot_tile = np.zeros(shape, np.int32)
    every = np.repeat(np.arange(len(size)), size)
    within = np.arange(len(every)) - np.repeat(np.cumsum(size) - size, size)
    slot_tile.ravel()[first[every] + within] = places.number[every]
    slot_tile = np.maximum.accumulate(slot_tile, 2)  # slots after the last tile of a chunk belong to it

    column, of_ray = _columns(tile), position[seen.point]
    ray = np.full((*shape, width), -1, np.int32)
    ray.ravel()[(first[tile[of_ray]] + entries.number) * width + column[of_ray]] = np.arange(len(seen.point))
    of_point = tile[position]
    return Tiling(
        np.stack([device[of_point], places.number[of_point], column[position]], 1),
        places.tile_slots,
        slot_image,
        slot_tile,
        ray,
        places.chunks,
        # each chunk is processed with the maximum number of tiles
        grid_size(int(places.number.max()) + 1 + max_tiles, FEWEST_TILES),
        max_tiles,
        group,
    )


def tiling(seen: Seen, devices: int, width: int) -> Tiling:
    """Tiles of points that have 1 to SLOTS rays each."""
    position = positions_along_curve(seen)
    of_ray = position[seen.point]
    tile = _cut(of_ray, seen, width)
    for narrow in (width // CUTS, 1):  # tiles with too many images are split
        entries = number_images(tile[of_ray], seen.image, seen.images, int(tile[-1]) + 1)
        wide = entries.counts > SLOTS
        if not wide.any():
            break
        split = tile * width + np.where(wide[tile], _columns(tile) // narrow, 0)
        tile = np.unique(split, return_inverse=True)[1]
    else:
        entries = number_images(tile[of_ray], seen.image, seen.images, int(tile[-1]) + 1)
    places = _deal(np.searchsorted(CLASSES, entries.counts), devices)
    shape = devices, grid_size(int(places.chunks.max())), SLOTS
    return laid_out(seen, tile, position, entries, places, shape=shape, width=width, max_tiles=MAX_TILES, group=1)


def padded_groups(groups: int) -> int:
    """Groups per chunk: few different numbers, at most a quarter more than needed."""
    step = 2 ** max(0, groups.bit_length() - 3)
    return -(-groups // step) * step


def _products(images: Int[np.ndarray, " tile"]) -> Int[np.ndarray, " tile"]:
    """Number of products of groups with groups, for tiles with a number of images."""
    groups = -(-images // GROUP)
    return groups * (groups + 1) // 2


def _joined(position: Int[np.ndarray, " ray"], seen: Seen, width: int) -> Int[np.ndarray, " position"]:
    """Tile of each position along the curve: rows of `width`, halved repeatedly if that saves products."""
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
    """Packs tiles into chunks of `capacity` groups, the largest first, and distributes the chunks over the devices."""
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
    """Tiles of points with more than SLOTS rays each."""
    position = positions_along_curve(seen)
    tile = _joined(position[seen.point], seen, width)
    entries = number_images(tile[position[seen.point]], seen.image, seen.images, int(tile[-1]) + 1)
    groups = -(-entries.counts // GROUP)
    capacity = padded_groups(int(groups.max()))
    places = _packed(groups, capacity, devices)
    shape = devices, grid_size(int(places.chunks.max()), 4), capacity * GROUP
    max_tiles = capacity // FEWEST_GROUPS
    return laid_out(seen, tile, position, entries, places, shape=shape, width=width, max_tiles=max_tiles, group=GROUP)
