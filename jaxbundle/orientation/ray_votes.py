"""Counting the pairs of images that agree with a ray."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.geometry.rotation import apply
from jaxbundle.geometry.vectors import Vector
from jaxbundle.numerics.devices import on_cores
from jaxbundle.orientation.block_pairs import BlockPairs, pair_fits
from jaxbundle.orientation.common_rays import CommonRays, Directions

TOGETHER = 200_000  # number of rays of pairs that are processed together


def votes(
    directions: Directions, common: CommonRays, pairs: BlockPairs, second: Bool[np.ndarray, " pair"]
) -> tuple[Int[np.ndarray, " ray"], Int[np.ndarray, " ray"]]:
    """For each ray the number of pairs that it fits, and the number of its pairs.

    `common`, `pairs`: the same pairs; `second`: mask of the pairs whose second orientation is correct.
    """
    lengths = np.array([len(rays) for rays in common.rays], int)
    every = np.arange(len(lengths))
    rotation = pairs.rotation[every, second.astype(int)].reshape(-1, 9).T
    base, vector = pairs.base[every, second.astype(int)].T, np.ascontiguousarray(directions.vector.T)
    rays = np.concatenate([np.zeros((0, 2), int), *common.rays])
    pair = np.repeat(every, lengths)

    def agrees(part: slice) -> Bool[np.ndarray, " ray"]:
        one, other = rays[part].T
        y = apply(tuple(rotation[:, pair[part]]), _vector(vector[:, one]))
        variance = (directions.sigma[one] ** 2 + directions.sigma[other] ** 2) / 2
        return pair_fits(y, _vector(vector[:, other]), _vector(base[:, pair[part]]), variance)[0]

    parts = [slice(start, start + TOGETHER) for start in range(0, len(rays), TOGETHER)]
    good = np.concatenate([np.zeros(0, bool), *on_cores(agrees, parts)])
    fits, total = (np.bincount(chosen.ravel(), minlength=len(directions.image)) for chosen in (rays[good], rays))
    return fits, total


def _vector(rows: Float[np.ndarray, "3 ray"]) -> Vector:
    return rows[0], rows[1], rows[2]


def share(fits: Int[np.ndarray, " ray"], total: Int[np.ndarray, " ray"]) -> Float[np.ndarray, " ray"]:
    """Share of the pairs that agree; 1 for a ray without pairs."""
    return np.where(total > 0, fits / np.maximum(total, 1), 1.0)
