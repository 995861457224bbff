"""Finding strips of successive images from common points and approximate projection centres."""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Structure

MIN_COMMON = 6  # minimum points of a model: five determine it, a sixth checks it
IN_ORDER = 1.3  # successive images of the block are preferred to others with up to this factor of common points
STRAIGHT = 0.5  # cosine of the maximum angle between successive bases of a strip
MIN_BASE = 0.01  # share of the distance to the points: a shorter base gives no intersections


class Candidates(NamedTuple):
    """Pairs of images with common points; the first image has the smaller index."""

    pair: Int[np.ndarray, "pair 2"]
    common: Int[np.ndarray, " pair"]


def candidates(structure: Structure) -> Candidates:
    """All pairs of images with enough common points for a model."""
    shape = len(structure.image_names), len(structure.point_names)
    seen = sp.csr_matrix((np.ones(len(structure.ray_image)), (structure.ray_image, structure.ray_point)), shape)
    seen.data[:] = 1  # a point measured twice on an image counts once
    common = sp.triu(seen @ seen.T, 1).tocoo()
    enough = common.data >= MIN_COMMON
    return Candidates(np.stack([common.row, common.col], 1)[enough], common.data[enough].astype(int))


def chains(
    structure: Structure, centres: Float[np.ndarray, "image 3"], points: Float[np.ndarray, "point 3"]
) -> list[list[int]]:
    """Groups all images into strips; an image without a neighbour is a strip of one image.

    Neighbours are the images with the most common points; each image has at most two neighbours, one on each side. A
    strip begins with the end image that is first in the block.
    """
    pairs = candidates(structure)
    i, j = pairs.pair.T
    base = centres[j] - centres[i]
    length = np.linalg.norm(base, axis=1)
    far = length > MIN_BASE * _distances(structure, centres, points)[pairs.pair].mean(1)
    preference = pairs.common * np.where((j - i == 1) & _along(centres)[i], IN_ORDER, 1.0)
    neighbours: list[list[int]] = [[] for _ in structure.image_names]
    strip = np.arange(len(neighbours))
    for k in np.argsort(-preference, kind="stable"):
        a, b = int(i[k]), int(j[k])
        open_ends = len(neighbours[a]) < 2 and len(neighbours[b]) < 2 and strip[a] != strip[b]
        if far[k] and open_ends and _straight(a, b, neighbours, centres) and _straight(b, a, neighbours, centres):
            neighbours[a].append(b)
            neighbours[b].append(a)
            strip[strip == strip[b]] = strip[a]
    return _walked(neighbours)


def _distances(
    structure: Structure, centres: Float[np.ndarray, "image 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, " image"]:
    """Mean distance from each image to its points."""
    away = np.linalg.norm(points[structure.ray_point] - centres[structure.ray_image], axis=1)
    known = np.isfinite(away)
    image, count = structure.ray_image[known], len(centres)
    return np.bincount(image, away[known], count) / np.maximum(np.bincount(image, minlength=count), 1)


def _along(centres: Float[np.ndarray, "image 3"]) -> Bool[np.ndarray, " image"]:
    """Whether the base from each image to the next one in the block is along a strip.

    Then it has the direction of the base before or after it, forwards or backwards, and does not connect two strips.
    """
    base = np.diff(centres, axis=0)
    base = base / np.maximum(np.linalg.norm(base, axis=1, keepdims=True), 1e-300)
    alike = np.abs(np.sum(base[1:] * base[:-1], 1)) >= STRAIGHT
    along = np.ones(len(centres), bool)
    if len(base) > 1:
        along[:-1] = np.append(alike, False) | np.insert(alike, 0, False)
    return along


def _straight(at: int, to: int, neighbours: list[list[int]], centres: Float[np.ndarray, "image 3"]) -> bool:
    """Whether the strip continues from its last images to another one without a reversal."""
    if not neighbours[at]:
        return True
    before, after = centres[at] - centres[neighbours[at][0]], centres[to] - centres[at]
    return bool(before @ after >= STRAIGHT * np.linalg.norm(before) * np.linalg.norm(after))


def _walked(neighbours: list[list[int]]) -> list[list[int]]:
    """The strips from one end to the other."""
    done, found = set(), []
    for start in range(len(neighbours)):
        if start in done or len(neighbours[start]) > 1:
            continue
        strip, image = [], start
        while image is not None:
            strip.append(image)
            done.add(image)
            image = next((other for other in neighbours[image] if other not in done), None)
        found.append(strip)
    return found
