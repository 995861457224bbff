"""Host plan of the reduced normal equations: order of the images, blocks of image pairs, solver."""

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
MAX_FACTOR = 4e9  # bytes; a larger matrix is not formed if its inverse is not needed
DENSE_UNKNOWNS = 160  # measured: up to this size one dense matrix is as fast as tiles, and compiles in half the time
FEWEST_BLOCKS = 64  # padded number: small blocks share a program
SMALL_UNKNOWNS, SMALL_ROWS, ROWS = 2500, 72, 144  # measured: 72 rows per tile are faster up to 2500 unknowns, 144 above


@dataclass(frozen=True)
class ReducedPlan:
    """The plan of the reduced equations; the last image and the last block are dummies."""

    rank: Int[np.ndarray, " image"]
    """Position of each image in elimination order."""
    pairs: Int[np.ndarray, "pair 2"]
    """Ranks (i, j), i >= j, of the used blocks, sorted."""
    padded_pairs: Int[np.ndarray, "padded 2"]
    """Ranks of all blocks; the padded number of images for unused blocks."""
    images: int
    """Images, padded."""
    panels: PanelLists | None
    """Lists of the factorisation in panels; None for a dense matrix."""
    method: Method
    """The selected solver."""
    shared_out: bool
    """Whether the panels are distributed over several devices."""

    @cached_property
    def block_of(self) -> Finder:
        """Function from two ranks, i >= j, to the block of their pair; the last block without one."""
        return pair_finder(self.pairs, self.images, self.blocks - 1)

    @property
    def blocks(self) -> int:
        """Padded number of blocks of image pairs."""
        return len(self.padded_pairs)


def panel_width(images: int, d: int) -> int:
    """Number of images per panel: large tiles have fast products, small ones a sparser pattern."""
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
    """Makes the plan for `images` images with `d` unknowns each and common points in `pairs`; `q` images per panel.

    "dense" and "panels" factorise the matrix; "pcg" has only the diagonal blocks, as a preconditioner.
    """
    q = q or panel_width(images, d)
    if method == "auto":
        method = "dense" if images * d <= DENSE_UNKNOWNS else "panels"
    devices = devices if method == "panels" else 1  # work that is not distributed is repeated on each device
    order = elimination_order(pairs, images, q, devices)
    pairs = ranked_pairs(pairs, order.rank)
    if method == "pcg":
        pairs = pairs[pairs[:, 0] == pairs[:, 1]]
    padded, blocks = grid_size(images + 1), grid_size(len(pairs) + 1, FEWEST_BLOCKS)
    padded_pairs = np.full((blocks, 2), padded, np.int32)
    padded_pairs[: len(pairs)] = pairs
    panels = None if method == "dense" else symbolic(pairs, order, q, devices, images=padded, blocks=blocks)
    return ReducedPlan(order.rank, pairs, padded_pairs, padded, panels, method, devices > 1)


def too_large(pairs: Int[np.ndarray, "pair 2"], images: int, d: int) -> bool:
    """Size of the envelope of the factor: all blocks from the first one of a row to its diagonal."""
    ranked = ranked_pairs(pairs, elimination_order(pairs, images, 1, 1).rank)
    first = np.minimum.reduceat(ranked[:, 1], np.searchsorted(ranked[:, 0], np.arange(images)))
    return 8.0 * d * d * float((np.arange(images) - first + 1).sum()) > MAX_FACTOR
