"""Orientations of a whole block only from its rays: pairs, averaged rotations, linear positions.

The result does not depend on a first pair and does not drift: all pairs are oriented, all rotations are averaged, and
all positions are computed, each in one step.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.orientation.approximation import Figure, Step
from jaxbundle.orientation.block_pairs import BlockPairs, block_pairs
from jaxbundle.orientation.common_rays import CommonRays, Directions, common_rays
from jaxbundle.orientation.linear_positions import Bases, Lines, chosen_points, positions
from jaxbundle.orientation.ray_votes import share, votes
from jaxbundle.orientation.rotation_average import Attitudes, averaged
from jaxbundle.orientation.triplets import triplet_errors

COARSER = 4.0  # factor of the standard deviations if few pairs fit: for a roughly known interior orientation
ENOUGH = 0.5  # minimum share of the pairs that fit
CLOSED = np.radians(2.0)  # right pairs close within some tenths of a degree, false twins by tens
DOUBTED = 1e-3  # a smaller weight means that most pairs of a ray contradict it


class PartOrientation(NamedTuple):
    """Images of one part in their own system; rotations camera_from_part."""

    images: Int[np.ndarray, " image"]
    rotation: Float[np.ndarray, "image 3 3"]
    centre: Float[np.ndarray, "image 3"]


class GlobalStart(NamedTuple):
    """The parts in decreasing size; rays that agree with most of their pairs; and the steps."""

    parts: tuple[PartOrientation, ...]
    believed: Bool[np.ndarray, " ray"]
    steps: tuple[Step, ...]


def global_start(directions: Directions) -> GlobalStart:
    """Orients all connected images."""
    common = common_rays(directions)
    pairs = block_pairs(directions, common)
    if pairs.accepted.sum() < ENOUGH * len(pairs.pairs):
        coarse = directions._replace(sigma=COARSER * directions.sigma)
        again = block_pairs(coarse, common)
        if again.accepted.sum() > 1.5 * pairs.accepted.sum():
            directions, pairs = coarse, again
    tried = len(pairs.pairs)
    common, pairs = _only(common, pairs, pairs.accepted)
    attitudes = averaged(pairs, directions.images)
    steps = [_pairs_step(tried, pairs), _rotations_step(attitudes, pairs)]
    common, pairs = _only(common, pairs, attitudes.used)
    agreeing = share(*votes(directions, common, pairs, attitudes.second[attitudes.used]))
    weight = np.where(agreeing >= 0.5, 1.0, DOUBTED)
    bases = _bases(pairs, attitudes)
    parts, figures = [], []
    numbers, sizes = np.unique(attitudes.part, return_counts=True)
    for number in numbers[np.argsort(-sizes, kind="stable")]:
        images = np.flatnonzero(attitudes.part == number)
        if len(images) > 1:
            part, found = _positioned(directions, attitudes, images, (weight, bases))
            parts.append(part)
            figures.append(found)
    steps += [Step("positions", found) for found in figures if found]
    return GlobalStart(tuple(parts), agreeing >= 0.5, tuple(steps))


def _only(common: CommonRays, pairs: BlockPairs, chosen: Bool[np.ndarray, " pair"]) -> tuple[CommonRays, BlockPairs]:
    rays = tuple(common.rays[k] for k in np.flatnonzero(chosen))
    return CommonRays(common.pairs[chosen], rays), pairs.only(chosen)


def _bases(pairs: BlockPairs, attitudes: Attitudes) -> Bases:
    """The bases of the pairs that are used, in the system of the attitudes."""
    second = attitudes.second[attitudes.used].astype(int)
    base = pairs.base[np.arange(len(second)), second]
    along = -np.einsum("pji,pj->pi", attitudes.rotation[pairs.pairs[:, 1]], base)  # X2 = R X1 + t, t = A2 (C1 - C2)
    return Bases(pairs.pairs, along, pairs.parallax)


def _positioned(
    directions: Directions,
    attitudes: Attitudes,
    images: Int[np.ndarray, " image"],
    known: tuple[Float[np.ndarray, " ray"], Bases],
) -> tuple[PartOrientation, tuple[Figure, ...]]:
    """Positions of one part; all equal if its rays have no parallax. `known`: weights of the rays, bases."""
    weight, bases = known
    place = np.full(directions.images, -1)
    place[images] = np.arange(len(images))
    rays = np.flatnonzero(place[directions.image] >= 0)
    points = chosen_points(place[directions.image[rays]], directions.point[rays], weight[rays], directions.points)
    rotation = attitudes.rotation[images]
    if not len(points):
        return PartOrientation(images, rotation, np.zeros((len(images), 3))), ()
    number = np.full(directions.points, -1)
    number[points] = np.arange(len(points))
    rays = rays[number[directions.point[rays]] >= 0]
    image = place[directions.image[rays]]
    along = np.einsum("rji,rj->ri", rotation[image], directions.vector[rays])
    sigma, believed = directions.sigma[rays], weight[rays]
    lines = Lines(image, number[directions.point[rays]], along, sigma, believed, len(images), len(points))
    inside = (place[bases.pair] >= 0).all(1)
    found = positions(lines, Bases(place[bases.pair[inside]], bases.along[inside], bases.parallax[inside]))
    typical = np.degrees(np.median(found.sine[believed > 0.5]))
    figures = (
        Figure("images", len(images)),
        Figure("points", len(points)),
        Figure("rays in front", 100 * found.in_front, "%"),
        Figure("median angle of the rays", typical, "deg"),
        Figure("second over first eigenvalue", found.eigenvalues[1] / max(abs(found.eigenvalues[0]), 1e-12)),
    )
    return PartOrientation(images, rotation, found.centre), figures


def _pairs_step(tried: int, pairs: BlockPairs) -> Step:
    some = len(pairs.pairs) > 0
    return Step(
        "pairs of images",
        (
            Figure("oriented", len(pairs.pairs)),
            Figure("of", tried),
            Figure("rays that fit", 100 * pairs.fits.sum() / max(pairs.looked_at.sum(), 1), "%"),
            Figure("median angle between rays", np.degrees(np.median(pairs.parallax)) if some else np.nan, "deg"),
        ),
    )


def _rotations_step(attitudes: Attitudes, pairs: BlockPairs) -> Step:
    _, open_by = triplet_errors(pairs.pairs, pairs.rotation[:, 0])
    closed = float((open_by < CLOSED).mean()) if len(open_by) else np.nan
    used = attitudes.residual[attitudes.used]
    return Step(
        "rotations averaged",
        (
            Figure("pairs left out", int((~attitudes.used).sum())),
            Figure("parts", len(np.unique(attitudes.part))),
            Figure("triplets", len(open_by)),
            Figure("triplets that close within 2 deg", 100 * closed, "%"),
            Figure("median misfit of a pair", np.degrees(np.median(used)) if len(used) else np.nan, "deg"),
            Figure("largest", np.degrees(used.max()) if len(used) else np.nan, "deg"),
        ),
    )
