"""Selecting the pairs of images for the orientation, and their common points.

A pair needs common points. Each image is paired with the images that share the most points, and the pairs of a maximum
spanning tree are added, so that connected images stay connected. From many common points a selection is spread over the
first image: few from each cell.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import minimum_spanning_tree

NEIGHBOURS = 7  # maximum number of pairs of an image
MIN_COMMON = 8  # minimum number of points of a pair: five determine the orientation
CELLS = 8  # cells of an image in each direction


class Directions(NamedTuple):
    """Rays as unit vectors in the systems of their photographs; `sigma`: standard deviation of a direction in rad."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    vector: Float[np.ndarray, "ray 3"]
    sigma: Float[np.ndarray, " ray"]
    images: int
    points: int


class CommonRays(NamedTuple):
    """Pairs of images and rays to their common points."""

    pairs: Int[np.ndarray, "pair 2"]
    rays: tuple[Int[np.ndarray, "_common 2"], ...]
    """For each pair all rays to common points, on both images."""


def common_rays(directions: Directions) -> CommonRays:
    """Selects the pairs for the orientation; a point that is measured twice on an image is used once."""
    shape = directions.images, directions.points
    order = np.lexsort((directions.point, directions.image))
    image, point = directions.image[order], directions.point[order]
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(image) != 0) | (np.diff(point) != 0)
    order, image, point = order[first], image[first], point[first]
    starts = np.searchsorted(image, np.arange(directions.images + 1))
    seen = scipy.sparse.csr_matrix((np.ones(len(order), np.float32), point, starts), shape)
    common = (seen @ seen.T).tocsr()
    common.setdiag(0)
    common.eliminate_zeros()
    pairs = _pairs(common)
    rays, place = [], np.full(directions.points, -1)
    at = -1
    for i, j in pairs:
        if i != at:
            place[:] = -1
            place[point[starts[i] : starts[i + 1]]] = order[starts[i] : starts[i + 1]]
            at = i
        other = order[starts[j] : starts[j + 1]]
        own = place[point[starts[j] : starts[j + 1]]]
        rays.append(np.stack([own, other], 1)[own >= 0])
    return CommonRays(pairs, tuple(rays))


def _pairs(common: Any) -> Int[np.ndarray, "pair 2"]:
    """Pairs of each image with the most common points, and a maximum spanning tree; the first index is smaller.

    `common`: numbers of common points, a sparse matrix in rows.
    """
    found = []
    for i in range(common.shape[0]):
        row = slice(common.indptr[i], common.indptr[i + 1])
        others, counts = common.indices[row], common.data[row]
        best = np.argsort(-counts, kind="stable")[:NEIGHBOURS]
        best = best[counts[best] >= MIN_COMMON]
        found.append(np.stack([np.full(len(best), i), others[best]], 1))
    enough = common.multiply(common >= MIN_COMMON).tocsr()
    enough.data = 1 / enough.data
    tree = minimum_spanning_tree(enough).tocoo()
    pairs = np.concatenate([*found, np.stack([tree.row, tree.col], 1)]).astype(int)
    return np.unique(np.sort(pairs, 1), axis=0)


def spread(vectors: Float[np.ndarray, "common 3"], number: int, rng: np.random.Generator) -> Int[np.ndarray, " chosen"]:
    """Indices of a number of rays that are spread over the image; all if there are fewer."""
    if len(vectors) <= number:
        return np.arange(len(vectors))
    plane = vectors[:, :2]
    low, high = plane.min(0), plane.max(0)
    x, y = np.minimum((plane - low) / np.maximum(high - low, 1e-300) * CELLS, CELLS - 1).astype(int).T
    mixed = rng.permutation(len(vectors))
    cell = (x * CELLS + y)[mixed]
    order = np.argsort(cell, kind="stable")
    count = np.bincount(cell, minlength=CELLS**2)
    rank = np.arange(len(order)) - (np.cumsum(count) - count)[cell[order]]
    return mixed[order[np.argsort(rank, kind="stable")[:number]]]
