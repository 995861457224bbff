"""Counting the pairs of images that agree with a ray."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.geometry.rotation import apply
from jaxbundle.geometry.vectors import Vector
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
    every = np.arange(len(lengths))
    rotation = pairs.rotation[every, second.astype(int)].reshape(-1, 9).T
    base, vector = pairs.base[every, second.astype(int)].T, np.ascontiguousarray(directions.vector.T)
    for group in _groups(lengths):
        one, other = np.concatenate([common.rays[k] for k in group]).T
        pair = np.repeat(group, lengths[group])
        y = apply(tuple(rotation[:, pair]), _vector(vector[:, one]))
        variance = (directions.sigma[one] ** 2 + directions.sigma[other] ** 2) / 2
        good, _ = pair_fits(y, _vector(vector[:, other]), _vector(base[:, pair]), variance)
        for rays in (one, other):
            total += np.bincount(rays, minlength=len(total))
            fits += np.bincount(rays[good], minlength=len(total))
    return fits, total


def _vector(rows: Float[np.ndarray, "3 ray"]) -> Vector:
    return rows[0], rows[1], rows[2]


def _groups(lengths: Int[np.ndarray, " pair"]) -> list[Int[np.ndarray, " _chosen"]]:
    group = np.cumsum(lengths) // TOGETHER
    return np.split(np.arange(len(lengths)), np.flatnonzero(np.diff(group)) + 1) if len(lengths) else []


def share(fits: Int[np.ndarray, " ray"], total: Int[np.ndarray, " ray"]) -> Float[np.ndarray, " ray"]:
    """Share of the pairs that agree; 1 for a ray without pairs."""
    return np.where(total > 0, fits / np.maximum(total, 1), 1.0)
