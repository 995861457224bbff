"""Symbolic factorisation of the reduced matrix: non-zero tiles, and the products that change them.

`q` images in elimination order are a panel, two panels (I, J) a tile of b x b numbers, b = q d. Eliminating panel J
with the panels R_J below it in its column changes each tile (A, B), A >= B, both in R_J:

    L_AB <- L_AB - L_AJ L_BJ^T,    so (A, B) becomes a tile of the pattern.

The tiles and products of each column are listed here once per structure, the device only processes the lists. With two
devices each has the columns of one end of the band and the separator, with separate numbering of panels and tiles:

    panels   end's columns, padding | separator's columns, padding
    tiles    end: diagonal tiles, tiles below, padding | separator: the same

All lists are padded to lengths on a geometric grid, so that blocks of similar size use the same program.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxbundle.normals.plan.elimination_order import Order
from jaxbundle.numerics.shapes import grid_size


class PanelColumns(NamedTuple):
    """Lists of panels that are eliminated one after the other; numpy arrays in the plan, JAX arrays in a program."""

    count: Int[Any, " part"]
    """Number of panels."""
    first_below: Int[Any, "part offset"]
    """Start of the tiles below each panel in `below`."""
    below: Int[Any, "part below 2"]
    """Tile, and panel of its row."""
    first_update: Int[Any, "part offset"]
    """Start of the updates of each panel in `update`."""
    update: Int[Any, "part update 3"]
    """Tiles (A, J), (B, J), (A, B); those of diagonal tiles, A = B, come first, one for each tile below."""
    block: Int[Any, "part tile q q"]
    """Block of the image pair at each position of each tile; the last block (0) without one."""


class PanelLists(NamedTuple):
    """The lists of each device; all devices after the second have those of the third."""

    ends: PanelColumns | None
    """Lists of one end of the band."""
    separator: PanelColumns
    """Lists of the separator, shared by both ends."""
    position: Int[Any, "part image"]
    """Panel times q plus the position of an image in the panel; outside the range for images of another device."""
    pair_place: Int[Any, "part pair 3"]
    """Tile, row and column of a pair's block; outside the range for blocks of another device, or without one."""


class _Lists(NamedTuple):
    """Lists of one part, not yet padded."""

    columns: int
    first_below: list[int]
    below: np.ndarray
    first_update: list[int]
    update: np.ndarray


def tile_grid(count: int) -> int:
    """The padded number of tiles."""
    return grid_size(count, 4, 1.25)


def list_grid(count: int) -> int:
    """Padded length of a list, at negligible cost."""
    return grid_size(count, 8, 4.0)


def fill(panels: Int[np.ndarray, "pair 2"], count: int) -> Bool[np.ndarray, "panel panel"]:
    """Tiles of the factor, lower half, from the pairs of panels (I >= J) of the matrix."""
    tiles = np.zeros((count, count), bool)
    tiles[panels[:, 0], panels[:, 1]] = True
    np.fill_diagonal(tiles, True)
    for j in range(count):
        r = np.nonzero(tiles[j + 1 :, j])[0] + j + 1
        tiles[np.ix_(r, r)] |= r[:, None] >= r
    return tiles


def _panels(order: Order, q: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Panel of each rank and its position there, and the panels of the parts; no panel belongs to two parts."""
    panel, place, parts, first = [], [], [], 0
    for size in order.sizes:
        k = np.arange(size)
        panel.append(first + k // q)
        place.append(k % q)
        parts.append(first + np.arange(-(-size // q)))
        first += -(-size // q)
    return np.concatenate(panel), np.concatenate(place), parts


def _number(tiles: np.ndarray, columns: np.ndarray, first: int, number: np.ndarray) -> int:
    """Numbers the tiles of `columns` from `first`, the diagonal ones first, and returns their number."""
    number[columns, columns] = first + np.arange(len(columns))
    row, column = np.nonzero(np.tril(tiles[:, columns], -columns[0] - 1 if len(columns) else 0))
    by_column = np.lexsort((row, column))
    number[row[by_column], columns[column[by_column]]] = first + len(columns) + np.arange(len(row))
    return len(columns) + len(row)


def _lists(tiles: np.ndarray, columns: np.ndarray, number: np.ndarray, panel_number: np.ndarray) -> _Lists:
    """Operations of the elimination of `columns`, in the numbering of this device."""
    below, update, first_below, first_update = [np.zeros((0, 2), int)], [np.zeros((0, 3), int)], [0], [0]
    for j in columns:
        r = np.nonzero(tiles[j + 1 :, j])[0] + j + 1
        a, b = (np.concatenate([np.arange(len(r)), k]) for k in np.tril_indices(len(r), -1))
        below.append(np.stack([number[r, j], panel_number[r]], 1))
        update.append(np.stack([number[r[a], j], number[r[b], j], number[r[a], r[b]]], 1))
        first_below.append(first_below[-1] + len(r))
        first_update.append(first_update[-1] + len(a))
    return _Lists(len(columns), first_below, np.concatenate(below), first_update, np.concatenate(update))


def _padded(arrays: list, length: int, value: int = 0) -> Int[np.ndarray, "part length *rest"]:
    """Stacks arrays of several parts, each padded with `value` along its first axis."""
    out = [np.full((length, *np.shape(a)[1:]), value, np.int32) for a in arrays]
    for padded, a in zip(out, arrays, strict=True):
        padded[: len(a)] = a
    return np.stack(out)


def _columns(lists: list[_Lists], blocks: list[np.ndarray], columns: int, tiles: int, waste: int) -> PanelColumns:
    """The padded lists of all parts."""
    return PanelColumns(
        np.array([s.columns for s in lists], np.int32),
        _padded([s.first_below for s in lists], columns + 1),
        _padded([s.below for s in lists], list_grid(max(len(s.below) for s in lists))),
        _padded([s.first_update for s in lists], columns + 1),
        _padded([s.update for s in lists], list_grid(max(len(s.update) for s in lists))),
        _padded(blocks, tiles, waste),
    )


def symbolic(
    pairs: Int[np.ndarray, "pair 2"], order: Order, q: int, devices: int, *, images: int, blocks: int
) -> PanelLists:
    """Lists of the factorisation. `pairs` in ranks, i >= j; `images`, `blocks`: padded numbers of images and of blocks.

    The last block belongs to no pair.
    """
    panel, place, parts = _panels(order, q)
    of_pair = panel[pairs]
    tiles = fill(of_pair, sum(len(p) for p in parts))
    split = len(parts[0]) > 0
    ends = [*parts[:2], parts[0][:0]][:devices] if split else []
    tiles_of = [int(tiles[:, p].sum()) for p in (*ends, parts[2])]
    columns = -(-images // q)
    end_panels = columns if split else 0
    end_tiles = tile_grid(max(tiles_of[:-1])) if split else 0
    tile_count = end_tiles + tile_grid(tiles_of[-1])
    panel_count = end_panels + columns

    lists, block_at, positions, pair_places = [], [], [], []
    for g, own in enumerate(ends or [parts[0]]):
        number, panel_number = np.full(tiles.shape, -1), np.full(len(tiles), panel_count)
        used = _number(tiles, own, 0, number), _number(tiles, parts[2], end_tiles, number)
        panel_number[own], panel_number[parts[2]] = np.arange(len(own)), end_panels + np.arange(len(parts[2]))
        lists.append((_lists(tiles, own, number, panel_number), _lists(tiles, parts[2], number, panel_number)))
        # the first device has the separator's part of the matrix; the others add the updates of their end
        answers = np.isin(of_pair[:, 1], own) | (g == 0) & np.isin(of_pair[:, 1], parts[2])
        tile = np.where(answers, number[of_pair[:, 0], of_pair[:, 1]], tile_count)
        pair_places.append(np.stack([tile, place[pairs[:, 0]], place[pairs[:, 1]]], 1))
        block = np.full((tile_count + 1, q, q), blocks - 1)
        block[tuple(pair_places[-1].T)] = np.arange(len(pairs))
        block_at.append((block[: used[0]], block[end_tiles : end_tiles + used[1]]))
        positions.append(np.where(panel_number[panel] < panel_count, panel_number[panel] * q + place, panel_count * q))
    return PanelLists(
        _columns([s for s, _ in lists], [b for b, _ in block_at], columns, end_tiles, blocks - 1) if split else None,
        _columns([s for _, s in lists], [b for _, b in block_at], columns, tile_count - end_tiles, blocks - 1),
        _padded(positions, images, panel_count * q),
        _padded(pair_places, blocks, tile_count),
    )
