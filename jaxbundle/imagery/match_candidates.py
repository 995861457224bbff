"""Candidates for homologous points of two images: mutual nearest descriptors with a clear second."""

import numpy as np
from jaxtyping import Float, Int

RATIO = 0.8  # ratio of the distances to the nearest and the second nearest descriptor (Lowe 2004, fig. 11)


def candidates(
    first: Float[np.ndarray, "one 128"], second: Float[np.ndarray, "other 128"], ratio: float = RATIO
) -> Int[np.ndarray, "candidate 2"]:
    """Pairs of features that are mutually nearest.

    Args:
        first: descriptors with unit length.
        second: descriptors of the other image.
        ratio: maximum ratio of the distance to that of the second nearest.
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), int)
    squared = np.maximum(2 - 2 * (first @ second.T), 0)
    nearest = np.argmin(squared, 1)
    two = np.partition(squared, 1, 1)[:, :2]
    one = np.arange(len(first))
    good = (np.argmin(squared, 0)[nearest] == one) & (two[:, 0] < ratio**2 * two[:, 1])
    return np.stack([one[good], nearest[good]], 1)
