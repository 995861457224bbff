"""The network of a block: images that see the same points."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array

from jaxbundle.report.figures import Figures

STRONGEST = 6  # number of connections of each image in a picture
WEAK = 20  # connections with fewer common points are called weak


class Connections(NamedTuple):
    """The strongest pairs of each image, with the number of common points."""

    pairs: Int[np.ndarray, "pair 2"]
    common: Int[np.ndarray, " pair"]
    of_all: int
    """Number of all pairs with common points."""


def connections(figures: Figures, strongest: int = STRONGEST) -> Connections:
    """The strongest connections of each image."""
    structure, images = figures.structure, len(figures.structure.image_names)
    rays, shape = (structure.ray_image, structure.ray_point), (images, len(structure.point_names))
    seen = coo_array((np.ones(len(rays[0]), np.int32), rays), shape=shape).tocsr()  # the rays of a pair are added
    seen.data[:] = 1
    common = (seen @ seen.T).tocoo()
    a, b = common.coords
    upper = a < b
    a, b, number = a[upper], b[upper], common.data[upper]
    both = np.concatenate([a, b]), np.tile(np.arange(len(a)), 2)
    order = np.lexsort((both[1], -number[both[1]], both[0]))
    owner = both[0][order]
    rank = np.arange(len(order)) - np.searchsorted(owner, owner)
    kept = np.unique(both[1][order][rank < strongest])
    return Connections(np.stack([a[kept], b[kept]], 1).astype(int), number[kept].astype(int), len(a))
