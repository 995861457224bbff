"""Counting the pairs of images that agree with a ray."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.orientation.block_pairs import BlockPairs, pair_fits
from jaxbundle.orientation.common_rays import CommonRays, Directions

TOGETHER = 400_000  # number of rays of pairs that are processed together


def votes(
    directions: Directions, common: CommonRays, pairs: BlockPairs, second: Bool[np.ndarray, " pair"]
) -> tuple[Int[np.ndarray, " ray"], Int[np.ndarray, " ray"]]:
    """For each ray the number of pairs that it fits, and the number of its pairs.

    `common`, `pairs`: the same pairs; `second`: mask of the pairs whose second orientation is correct.
    """
    fits, total = (np.zeros(len(directions.image), int) for _ in range(2))
    lengths = np.array([len(rays) for rays in common.rays], int)
    for first in _groups(lengths):
        index = np.concatenate([common.rays[k] for k in first])
        pair = np.repeat(first, lengths[first])
        k = second[pair].astype(int)
        y = np.einsum("rij,rj->ri", pairs.rotation[pair, k], directions.vector[index[:, 0]])
        variance = (directions.sigma[index] ** 2).mean(1)
        good, _ = pair_fits(y, directions.vector[index[:, 1]], pairs.base[pair, k], variance)
        for side in range(2):
            total += np.bincount(index[:, side], minlength=len(total))
            fits += np.bincount(index[good, side], minlength=len(total))
    return fits, total


def _groups(lengths: Int[np.ndarray, " pair"]) -> list[Int[np.ndarray, " chosen"]]:
    group = np.cumsum(lengths) // TOGETHER
    return np.split(np.arange(len(lengths)), np.flatnonzero(np.diff(group)) + 1) if len(lengths) else []


def share(fits: Int[np.ndarray, " ray"], total: Int[np.ndarray, " ray"]) -> Float[np.ndarray, " ray"]:
    """Share of the pairs that agree; 1 for a ray without pairs."""
    return np.where(total > 0, fits / np.maximum(total, 1), 1.0)
