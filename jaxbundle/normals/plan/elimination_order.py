"""Pairs of images with common points, and the elimination order of their unknowns.

The reduced matrix has a block for each pair of images with common points. Reverse Cuthill-McKee numbers the images
along the block, so that these pairs are in a band. With two devices the band is eliminated from both ends:

    rank     0 ..... l-1   l ......... l+r-1   l+r ..... images-1
    part     left end ->   right end, reversed ->   separator
             first device  second device            both

No image of the left end shares a point with one of the right end; the separator is the part between them.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Int
from scipy.sparse.csgraph import reverse_cuthill_mckee

SEPARATOR_WEIGHT = 1.5  # its columns have the most non-zeros, and both devices process them
WORTHWHILE = 0.85  # share of the time on one device; the sum over the devices needs some


class Order(NamedTuple):
    """Rank of each image, and numbers of images of the left end, the right end and the separator."""

    rank: Int[np.ndarray, " image"]
    sizes: tuple[int, int, int]


def image_graph(
    ray_image: Int[np.ndarray, " ray"],
    ray_point: Int[np.ndarray, " ray"],
    images: int,
    points: int,
    extra: Int[np.ndarray, "extra 2"] | None = None,
) -> Int[np.ndarray, "pair 2"]:
    """All pairs (i, j), i >= j, of images with common points, each image with itself, and `extra` pairs.

    Many points have equal tracks, so only different tracks are expanded. A track is identified by the sum of random
    62-bit numbers of its images: of a million tracks, two agree by chance in one of four million blocks.
    """
    if np.any(ray_point[1:] < ray_point[:-1]):
        order = np.argsort(ray_point, kind="stable")
        ray_image, ray_point = ray_image[order], ray_point[order]
    length = np.bincount(ray_point, minlength=points)
    start = np.concatenate([[0], np.cumsum(length)])
    mark = np.random.default_rng(0).integers(0, 2**62, images, dtype=np.int64)[ray_image]
    mark = np.concatenate([[0], np.cumsum(mark)])  # overflow is harmless here
    first = np.unique(mark[start[1:]] - mark[start[:-1]], return_index=True)[1]
    length = length[first]
    end = np.cumsum(length)
    ray = np.arange(length.sum()) + np.repeat(start[first] - end + length, length)
    tracks = sp.csr_matrix(
        (np.ones(len(ray), np.float32), ray_image[ray], np.concatenate([[0], end])), (len(first), images)
    )
    shared = sp.tril(tracks.T @ tracks, -1).tocoo()
    every = np.arange(images)
    pairs = [np.stack([shared.row, shared.col], 1), np.stack([every, every], 1)]
    if extra is not None:
        pairs.append(np.sort(extra, 1)[:, ::-1])
    return _unique_pairs(np.concatenate(pairs).astype(np.int64), images)


def _unique_pairs(pairs: Int[np.ndarray, "all 2"], images: int) -> Int[np.ndarray, "pair 2"]:
    """Different pairs, sorted by the first and then the second image."""
    code = np.unique(pairs[:, 0] * images + pairs[:, 1])
    return np.stack(np.divmod(code, images), 1)


def ranked_pairs(pairs: Int[np.ndarray, "pair 2"], rank: Int[np.ndarray, " image"]) -> Int[np.ndarray, "pair 2"]:
    """The pairs (i, j), i >= j, as ranks, sorted in the order of the blocks."""
    return _unique_pairs(np.sort(rank[pairs], 1)[:, ::-1], len(rank))


def elimination_order(pairs: Int[np.ndarray, "pair 2"], images: int, q: int, devices: int) -> Order:
    """The order of elimination for panels of `q` images; two ends with two devices, if it is faster."""
    i, j = pairs.T
    graph = sp.csr_matrix((np.ones(2 * len(i), np.int8), (np.r_[i, j], np.r_[j, i])), (images, images))
    order = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), np.int64)
    rank = np.empty(images, np.int64)
    rank[order] = np.arange(images)
    sizes = 0, 0, images
    if devices > 1:
        order, sizes = _two_ends(order, np.sort(rank[pairs], 1), q)
        rank[order] = np.arange(images)
    return Order(rank, sizes)


def _two_ends(
    order: Int[np.ndarray, " image"], pairs: Int[np.ndarray, "pair 2"], q: int
) -> tuple[Int[np.ndarray, " image"], tuple[int, int, int]]:
    """Cuts the band at the best position: images before `cut` share points only with images before `end`."""
    images = len(order)
    reach = np.arange(images)
    np.maximum.at(reach, pairs[:, 0], pairs[:, 1])
    cut = np.arange(q, images, q)
    end = np.maximum.accumulate(reach)[cut - 1] + 1
    time = np.maximum(cut, images - end) + SEPARATOR_WEIGHT * (end - cut)
    time = np.where(end < images, time, np.inf)
    if len(cut) == 0 or time.min() >= WORTHWHILE * images:
        return order, (0, 0, images)
    best = np.argmin(time)
    cut, end = int(cut[best]), int(end[best])
    order = np.concatenate([order[:cut], order[end:][::-1], order[cut:end]])
    return order, (cut, images - end, end - cut)
