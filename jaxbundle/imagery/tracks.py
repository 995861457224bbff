"""Tracks: features of several images that belong to one point of the terrain."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

NEIGHBOURS = 12  # points for the affine map around a point: twice the minimum for six parameters
MIN_COMMON = 6  # minimum common points of two images


class Tracks(NamedTuple):
    """Rays of tracks, sorted by point."""

    image: Int[np.ndarray, " ray"]
    feature: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]


def tracks(counts: Sequence[int], pairs: Mapping[tuple[int, int], Int[np.ndarray, "_match 2"]]) -> Tracks:
    """Joins the matches of all pairs of images to tracks.

    A track with two features of one image is contradictory and is left out.

    Args:
        counts: number of features of each image.
        pairs: for two images the indices of matching features.
    """
    offset = np.concatenate([[0], np.cumsum(counts)])
    total = int(offset[-1])
    edges = [m + (offset[i], offset[j]) for (i, j), m in pairs.items()]
    joined = np.concatenate([np.zeros((0, 2), int), *edges])
    graph = coo_array((np.ones(len(joined), bool), (joined[:, 0], joined[:, 1])), (total, total))
    label = connected_components(graph, directed=False)[1] if total else np.zeros(0, int)
    image = np.repeat(np.arange(len(counts)), counts)
    size = np.bincount(label, minlength=1)
    _, repeated = np.unique(label * len(counts) + image, return_counts=True)
    keys = np.unique(label * len(counts) + image)
    contradicts = np.zeros(len(size), bool)
    contradicts[keys[repeated > 1] // max(len(counts), 1)] = True
    used = np.flatnonzero((size[label] > 1) & ~contradicts[label])
    used = used[np.lexsort((image[used], label[used]))]
    point = np.unique(label[used], return_inverse=True)[1]
    return Tracks(image[used], used - offset[image[used]], point)


def local_affine(
    first: Float[np.ndarray, "point 2"], second: Float[np.ndarray, "point 2"], at: Float[np.ndarray, "place 2"]
) -> Float[np.ndarray, "place 2 2"]:
    """Derivatives of coordinates in the second image with respect to those in the first one, from neighbouring points.

    Args:
        first: common points in the first image.
        second: the same points in the second image.
        at: positions in the first image.

    Returns: least-squares affine maps of the 12 nearest points, NaN for fewer than 6 common points.
    """
    if len(first) < MIN_COMMON:
        return np.full((len(at), 2, 2), np.nan)
    squared = ((at[:, None] - first) ** 2).sum(2)
    number = min(NEIGHBOURS, len(first))
    near = np.argpartition(squared, number - 1, 1)[:, :number]
    x, y = first[near], second[near]
    x, y = x - x.mean(1, keepdims=True), y - y.mean(1, keepdims=True)
    normals = x.swapaxes(1, 2) @ x
    return np.linalg.solve(normals + 1e-9 * np.eye(2), x.swapaxes(1, 2) @ y).swapaxes(1, 2)
