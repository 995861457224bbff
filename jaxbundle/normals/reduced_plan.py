"""Host plan of the reduced normal equations: the order of the images, the pool of blocks and the way to solve them."""

from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxbundle.normals.dense_cholesky import DenseCholesky
from jaxbundle.normals.ordering import elimination_order, ranked_pairs
from jaxbundle.normals.panel_cholesky import PanelCholesky
from jaxbundle.normals.reduced_system import ReducedSolver
from jaxbundle.normals.symbolic import symbolic
from jaxbundle.normals.tiles import grid_size

Method = Literal["auto", "dense", "panels"]
DENSE_UNKNOWNS = 300  # below, one dense matrix is as fast as tiles
PANEL_ROWS = 144  # a tile that makes a fast product and still leaves a sparse pattern


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


def panel_width(d: int) -> int:
    """Images a panel."""
    return max(4, 4 * round(PANEL_ROWS / d / 4))


def reduced_plan(
    pairs: Int[np.ndarray, "pair 2"],
    images: int,
    d: int,
    devices: int = 1,
    method: Method = "auto",
    q: int | None = None,
    axis: str = "device",
) -> ReducedPlan:
    """The plan for `images` images with `d` unknowns each that share points in `pairs`."""
    q = q or panel_width(d)
    dense = images * d <= DENSE_UNKNOWNS if method == "auto" else method == "dense"
    order = elimination_order(pairs, images, q, 1 if dense else devices)
    pairs = ranked_pairs(pairs, order.rank)
    padded, pool = grid_size(images + 1), grid_size(len(pairs) + 1)
    pair = np.full((pool, 2), padded, np.int32)
    pair[: len(pairs)] = pairs
    pair = jnp.asarray(pair)
    if dense:
        way = DenseCholesky(pair, jnp.arange(padded, dtype=jnp.int32))
    else:
        way = PanelCholesky(symbolic(pairs, order, q, devices, padded, pool), axis if devices > 1 else None)
    return ReducedPlan(order.rank, pairs, padded, pool, ReducedSolver(pair, way))
