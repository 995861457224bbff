"""Host plan of the reduced normal equations: the order of the images, the pool of blocks and the way to solve them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int

from jaxbundle.normals.dense_cholesky import DenseCholesky
from jaxbundle.normals.ordering import elimination_order, ranked_pairs
from jaxbundle.normals.panel_cholesky import PanelCholesky
from jaxbundle.normals.reduced_system import ReducedSolver
from jaxbundle.normals.symbolic import symbolic
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size

Method = Literal["auto", "dense", "panels", "pcg"]
LARGEST_FACTOR = 4e9  # bytes; a larger one is not formed where nothing asks for its inverse
DENSE_UNKNOWNS = 160  # measured: up to here one dense matrix is as fast as tiles, and it compiles in half the time
SMALL_UNKNOWNS, SMALL_ROWS, ROWS = 2500, 72, 144  # measured: 72 rows a tile are faster up to 2500 unknowns, 144 beyond


@dataclass(frozen=True)
class ReducedPlan:
    """`rank`: place of an image in the order. `pairs`: ranks (i, j), i >= j, of the used blocks of the pool, sorted.

    `images`, `pool`: padded numbers of images and of blocks; the last image is a dummy, and block `pool` - 1 takes what
    belongs nowhere.
    """

    rank: Int[np.ndarray, " image"]
    pairs: Int[np.ndarray, "pair 2"]
    images: int
    pool: int
    solver: ReducedSolver
    method: Method


def panel_width(images: int, d: int) -> int:
    """Images a panel: large tiles make fast products, small ones leave more of the pattern empty."""
    rows = SMALL_ROWS if images * d <= SMALL_UNKNOWNS else ROWS
    return 4 * max(1, round(rows / d / 4))


def reduced_plan(
    pairs: Int[np.ndarray, "pair 2"],
    images: int,
    d: int,
    devices: int = 1,
    method: Method = "auto",
    q: int | None = None,
    axis: str = "device",
) -> ReducedPlan:
    """The plan for `images` images with `d` unknowns each that share points in `pairs`; `q` images a panel.

    "dense" and "panels" factorise the matrix; "pcg" has the diagonal blocks only, as a preconditioner.
    With several devices the solver's functions run inside a shard_map over `axis`, all of their arrays replicated.
    """
    q = q or panel_width(images, d)
    if method == "auto":
        method = "dense" if images * d <= DENSE_UNKNOWNS else "panels"
    devices = devices if method == "panels" else 1  # what is not shared out, every device does
    order = elimination_order(pairs, images, q, devices)
    pairs = ranked_pairs(pairs, order.rank)
    if method == "pcg":
        pairs = pairs[pairs[:, 0] == pairs[:, 1]]
    padded, pool = grid_size(images + 1), grid_size(len(pairs) + 1)
    pair = np.full((pool, 2), padded, np.int32)
    pair[: len(pairs)] = pairs
    pair = on_device(pair)
    if method == "dense":
        way = DenseCholesky(pair, on_device(np.arange(padded), np.int32))
    else:
        way = PanelCholesky(symbolic(pairs, order, q, devices, padded, pool), axis if devices > 1 else None)
    return ReducedPlan(order.rank, pairs, padded, pool, ReducedSolver(pair, way), method)


def too_large(pairs: Int[np.ndarray, "pair 2"], images: int, d: int) -> bool:
    """Whether the factor is: all blocks from the first one of a row to its diagonal, in a good order."""
    ranked = ranked_pairs(pairs, elimination_order(pairs, images, 1, 1).rank)
    first = np.minimum.reduceat(ranked[:, 1], np.searchsorted(ranked[:, 0], np.arange(images)))
    return 8.0 * d * d * float((np.arange(images) - first + 1).sum()) > LARGEST_FACTOR
