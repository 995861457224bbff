"""Host plan of the reduced normal equations: the order of the images, the blocks of image pairs, the way to solve."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Int

from jaxbundle.normals.plan.elimination_order import elimination_order, ranked_pairs
from jaxbundle.normals.plan.pair_lists import Finder, pair_finder
from jaxbundle.normals.plan.panel_lists import PanelLists, symbolic
from jaxbundle.numerics.shapes import grid_size

Method = Literal["auto", "dense", "panels", "pcg"]
MAX_FACTOR = 4e9  # bytes; a larger one is not formed where nothing asks for its inverse
DENSE_UNKNOWNS = 160  # measured: up to here one dense matrix is as fast as tiles, and it compiles in half the time
SMALL_UNKNOWNS, SMALL_ROWS, ROWS = 2500, 72, 144  # measured: 72 rows a tile are faster up to 2500 unknowns, 144 beyond


@dataclass(frozen=True)
class ReducedPlan:
    """The plan; the last image is a dummy, and the last block takes what belongs nowhere."""

    rank: Int[np.ndarray, " image"]
    """Position of each image in the order of elimination."""
    pairs: Int[np.ndarray, "pair 2"]
    """Ranks (i, j), i >= j, of the blocks in use, sorted."""
    padded_pairs: Int[np.ndarray, "padded 2"]
    """The same for all blocks; the padded number of images where a block is not in use."""
    images: int
    """Images, padded."""
    panels: PanelLists | None
    """Lists of the factorisation in panels; None where the matrix is dense."""
    method: Method
    """What "auto" came to."""
    shared_out: bool
    """Whether the panels are shared out to several devices."""

    @cached_property
    def block_of(self) -> Finder:
        """Function from two ranks, i >= j, to the block of their pair; the last block where they have none."""
        return pair_finder(self.pairs, self.images, self.blocks - 1)

    @property
    def blocks(self) -> int:
        """Blocks of image pairs, padded."""
        return len(self.padded_pairs)


def panel_width(images: int, d: int) -> int:
    """Images per panel: large tiles make fast products, small ones leave more of the pattern empty."""
    rows = SMALL_ROWS if images * d <= SMALL_UNKNOWNS else ROWS
    return 4 * max(1, round(rows / d / 4))


def reduced_plan(
    pairs: Int[np.ndarray, "pair 2"],
    images: int,
    d: int,
    devices: int = 1,
    method: Method = "auto",
    *,
    q: int | None = None,
) -> ReducedPlan:
    """The plan for `images` images with `d` unknowns each that share points in `pairs`; `q` images per panel.

    "dense" and "panels" factorise the matrix; "pcg" has the diagonal blocks only, as a preconditioner.
    """
    q = q or panel_width(images, d)
    if method == "auto":
        method = "dense" if images * d <= DENSE_UNKNOWNS else "panels"
    devices = devices if method == "panels" else 1  # what is not shared out, every device does
    order = elimination_order(pairs, images, q, devices)
    pairs = ranked_pairs(pairs, order.rank)
    if method == "pcg":
        pairs = pairs[pairs[:, 0] == pairs[:, 1]]
    padded, blocks = grid_size(images + 1), grid_size(len(pairs) + 1)
    padded_pairs = np.full((blocks, 2), padded, np.int32)
    padded_pairs[: len(pairs)] = pairs
    panels = None if method == "dense" else symbolic(pairs, order, q, devices, images=padded, blocks=blocks)
    return ReducedPlan(order.rank, pairs, padded_pairs, padded, panels, method, devices > 1)


def too_large(pairs: Int[np.ndarray, "pair 2"], images: int, d: int) -> bool:
    """Whether the factor is: all blocks from the first one of a row to its diagonal, in a good order."""
    ranked = ranked_pairs(pairs, elimination_order(pairs, images, 1, 1).rank)
    first = np.minimum.reduceat(ranked[:, 1], np.searchsorted(ranked[:, 0], np.arange(images)))
    return 8.0 * d * d * float((np.arange(images) - first + 1).sum()) > MAX_FACTOR
