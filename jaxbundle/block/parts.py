"""Parts of a block: groups of images with too few common points to fix them relative to each other.

Three points common to two groups of images fix all seven parameters of the similarity transformation between them; two
leave a rotation open, one all rotations and the scale. So images with three common points belong together, and also
groups with three common points.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Int
from scipy.sparse.csgraph import connected_components

from jaxbundle.block.block import Structure

HOLDING = 3  # common points that fix a similarity transformation, unless they lie on a line


@dataclass(frozen=True, eq=False)
class Part:
    """Images that are connected, their points, and those of these points that other parts also see."""

    images: Int[np.ndarray, " image"]
    points: Int[np.ndarray, " point"]
    common: Int[np.ndarray, " common"]


def parts_of(structure: Structure) -> tuple[Part, ...]:
    """The parts of a block in decreasing size; one part if all images are connected."""
    images, points = len(structure.image_names), len(structure.point_names)
    seen = _incidence(structure.ray_image, structure.ray_point, (images, points))
    labels = np.arange(images)
    while True:
        groups = int(labels.max()) + 1
        by_group = _incidence(labels[seen.nonzero()[0]], seen.nonzero()[1], (groups, points))
        count, merged = connected_components(by_group @ by_group.T >= HOLDING, directed=False)
        if count == groups:
            break
        labels = merged[labels]
    shared = np.asarray(by_group.sum(0)).ravel() > 1
    parts = []
    for group in range(count):
        own = by_group[[group]].nonzero()[1]
        parts.append(Part(np.flatnonzero(labels == group), own, own[shared[own]]))
    return tuple(sorted(parts, key=lambda part: (-len(part.images), part.images[0])))


def _incidence(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> scipy.sparse.csr_matrix:
    """Sparse matrix with 1 where a row sees a column at least once."""
    matrix = scipy.sparse.csr_matrix((np.ones(len(rows), int), (rows, columns)), shape)
    matrix.data[:] = 1
    return matrix
