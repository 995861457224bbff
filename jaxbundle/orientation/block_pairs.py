"""Robust relative orientations of all pairs of a block, in rounds of equal arrays.

Each round draws `SAMPLES` samples of each pair that is not finished. A pair is finished when one of its samples is
free of wrong rays with a probability of 99.9 %, for the share of rays that fit its best orientation (Fischler
and Bolles 1981).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.geometry.rotation import apply
from jaxbundle.geometry.vectors import Vector, components, cross, dot
from jaxbundle.numerics.devices import on_cores
from jaxbundle.numerics.host import on_device
from jaxbundle.orientation.common_rays import MIN_COMMON, CommonRays, Directions, spread
from jaxbundle.orientation.pair_kernel import PARALLEL, REJECTED, PairRays, oriented_pairs

PAIRS, RAYS, SAMPLES = 64, 48, 32  # pairs of one call: one program for all blocks
CONSIDERED = 8 * RAYS  # rays of a pair, drawn from all, from which spread ones are selected
MAX_SAMPLES = 512  # maximum samples of a pair
RETRIES = 8  # further calls for the first pairs without an orientation: few pairs get many samples each
SURE = 7.0  # -log(0.001)
NOISE = 1.5  # factor of samples, since correct rays have random errors
MIN_SHARE = 0.25  # minimum share of the common rays that fit an accepted pair
PAIRS_FOR_OPTIMISATION = 600  # below this number, the pairs take less time than optimising the program


class BlockPairs(NamedTuple):
    """Pairs of images with the best and the second orientation, X2 = R X1 + t with t of length 1.

    `fits`: number of used rays that fit and lie in front; `looked_at`: number of used rays. `parallax`: median angle
    between the rays of a point in rad. `second_cost`: ratio of the costs of the second and the best orientation.
    """

    pairs: Int[np.ndarray, "pair 2"]
    rotation: Float[np.ndarray, "pair 2 3 3"]
    base: Float[np.ndarray, "pair 2 3"]
    fits: Int[np.ndarray, " pair"]
    looked_at: Int[np.ndarray, " pair"]
    parallax: Float[np.ndarray, " pair"]
    second_cost: Float[np.ndarray, " pair"]

    @property
    def accepted(self) -> Bool[np.ndarray, " pair"]:
        """Mask of the pairs with enough fitting rays."""
        return _enough(self.fits, self.looked_at)

    def only(self, chosen: Bool[np.ndarray, " pair"] | Int[np.ndarray, " chosen"]) -> "BlockPairs":
        """The selection of some pairs."""
        return BlockPairs(*(values[chosen] for values in self))


class _Gathered(NamedTuple):
    """Rays of the pairs, padded with zeros."""

    first: Float[np.ndarray, "pair ray 3"]
    second: Float[np.ndarray, "pair ray 3"]
    variance: Float[np.ndarray, "pair ray"]
    valid: Bool[np.ndarray, "pair ray"]

    def only(self, chosen: Int[np.ndarray, " chosen"]) -> "_Gathered":
        """The rays of the selected pairs."""
        return _Gathered(*(x[chosen] for x in self))


class _Best(NamedTuple):
    """The best and the second orientation of each pair so far: R and t in rows, and their costs."""

    values: Float[np.ndarray, "pair 12 2"]
    costs: Float[np.ndarray, "pair 2"]


def block_pairs(directions: Directions, common: CommonRays) -> BlockPairs:
    """Computes the orientations of all pairs."""
    rng = np.random.default_rng(0)  # a fixed seed: the same block gives the same start
    rays = _gathered(directions, common, rng)
    count = len(common.pairs)
    best = _Best(np.zeros((count, 12, 2)), np.full((count, 2), np.inf))
    left, drawn = np.arange(count), np.zeros(count, int)
    while len(left):
        drawn += _sampled(rays, left, best, rng)
        share = _looked_at(rays.only(left), best.values[left])[0] / np.maximum(rays.valid[left].sum(1), 1)
        needed = NOISE * SURE / np.maximum(share, 0.1) ** 5
        left = left[drawn[left] < np.minimum(needed, MAX_SAMPLES)]
    values, costs, looked_at = *best, rays.valid.sum(1)
    for _ in range(RETRIES):
        left = np.flatnonzero(~_enough(_looked_at(rays, values)[0], looked_at))[:PAIRS]
        if not len(left):
            break
        _sampled(rays, left, best, rng)
    fits, parallax = _looked_at(rays, values)
    values[..., 1] = np.where(np.isfinite(costs[:, 1:]), values[..., 1], values[..., 0])
    rotation = values[:, :9].reshape(count, 3, 3, 2).transpose(0, 3, 1, 2)
    with np.errstate(invalid="ignore"):
        second = np.nan_to_num(costs[:, 1] / np.maximum(costs[:, 0], 1e-12), nan=np.inf)
    return BlockPairs(common.pairs, rotation, values[:, 9:].transpose(0, 2, 1), fits, looked_at, parallax, second)


def _enough(fits: Int[np.ndarray, " pair"], looked_at: Int[np.ndarray, " pair"]) -> Bool[np.ndarray, " pair"]:
    return (fits >= MIN_COMMON) & (fits >= MIN_SHARE * looked_at)


def _sampled(
    rays: _Gathered, pairs: Int[np.ndarray, " chosen"], best: _Best, rng: np.random.Generator
) -> Int[np.ndarray, " pair"]:
    """One round of samples of some pairs, which improves `best`; returns the number of samples of each pair."""
    count = len(best.costs)
    # a few pairs are sampled several times: the last call is filled with others
    calls = [np.resize(pairs[start : start + PAIRS], PAIRS) for start in range(0, len(pairs), PAIRS)]
    seeded = list(zip(calls, rng.spawn(len(calls)), strict=True))
    oriented = on_cores(lambda call: _oriented(rays, *call, count >= PAIRS_FOR_OPTIMISATION), seeded)
    for chosen, (new, new_costs) in zip(calls, oriented, strict=True):
        order = np.argsort(-new_costs[:, 0], kind="stable")  # the best of several results of a pair is written last
        order = order[new_costs[order, 0] < best.costs[chosen[order], 0]]
        best.values[chosen[order]], best.costs[chosen[order]] = new[order], new_costs[order]
    return SAMPLES * np.bincount(np.concatenate(calls), minlength=count)


def _gathered(directions: Directions, common: CommonRays, rng: np.random.Generator) -> _Gathered:
    index, valid = np.zeros((len(common.pairs), RAYS, 2), int), np.zeros((len(common.pairs), RAYS), bool)
    for k, rays in enumerate(common.rays):
        some = rays if len(rays) <= CONSIDERED else rng.choice(rays, CONSIDERED, replace=False, shuffle=False)
        chosen = some[spread(directions.vector[some[:, 0]], RAYS, rng)]
        index[k, : len(chosen)], valid[k, : len(chosen)] = chosen, True
    first, second = (directions.vector[index[..., k]] for k in range(2))
    variance = (directions.sigma[index] ** 2).mean(-1)
    return _Gathered(first, second, variance, valid)


def _oriented(
    rays: _Gathered, chosen: Int[np.ndarray, " chosen"], rng: np.random.Generator, optimised: bool
) -> tuple[Float[np.ndarray, "chosen 12 2"], Float[np.ndarray, "chosen 2"]]:
    """One round for the pairs of one call."""
    uniform = np.where(rays.valid[chosen][:, None], rng.random((PAIRS, SAMPLES, RAYS)), 2.0)
    samples = uniform.argpartition(5, axis=2)[:, :, :5].transpose(2, 1, 0)
    first, second = (on_device(np.ascontiguousarray(x[chosen].transpose(2, 1, 0))) for x in (rays.first, rays.second))
    part = PairRays(
        first,
        second,
        on_device(np.ascontiguousarray(rays.variance[chosen].T)),
        on_device(np.ascontiguousarray(rays.valid[chosen].T)),
    )
    values, costs = oriented_pairs(part, on_device(np.ascontiguousarray(samples)), optimised=optimised)
    return np.asarray(values).transpose(2, 0, 1), np.asarray(costs).T


def _looked_at(
    rays: _Gathered, values: Float[np.ndarray, "pair 12 2"]
) -> tuple[Int[np.ndarray, " pair"], Float[np.ndarray, " pair"]]:
    """Numbers of rays that fit the best orientation, and median angles between the rays of a point."""
    rotation, base = values[:, :9, 0].reshape(-1, 3, 3), values[:, 9:, 0]
    y = apply(tuple(rotation.reshape(-1, 9, 1).swapaxes(0, 1)), components(rays.first))
    fits, sine_squared = pair_fits(y, components(rays.second), components(base[:, None]), rays.variance)
    fits &= rays.valid
    counted = np.where(fits.any(1, keepdims=True), fits, rays.valid)  # of wrong rays the angles are anything
    angle = np.where(counted, np.sqrt(np.maximum(sine_squared, 0)), np.nan)
    return fits.sum(1), np.nanmedian(angle, 1)


def pair_fits(
    y: Vector, second: Vector, base: Vector, variance: Float[np.ndarray, "..."]
) -> tuple[Bool[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Whether rays fit and do not meet behind a photograph, and squared sines of the angles between them.

    `y`, `second`: rays in the system of the second photograph; `base`: unit vector.
    """
    f = np.asarray(dot(base, cross(y, second)))
    a, yt, dt = np.asarray(dot(y, second)), np.asarray(dot(y, base)), np.asarray(dot(second, base))
    g = 2 - yt**2 - dt**2 - 2 * f * f
    fits = f * f < REJECTED * variance * np.maximum(g, 1e-12)
    behind = (1 - a * a > 2 * PARALLEL * variance) & ((a * dt - yt <= 0) | (dt - a * yt <= 0))
    return fits & ~behind, 1 - a * a
