"""Pairs of images, their candidates verified by the relative orientation."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.imagery.interest_points import Features
from jaxbundle.imagery.match_candidates import candidates
from jaxbundle.orientation.relative_orientations import relative_orientation

ROWS = 512  # points of a relative orientation: one program for all pairs
MIN_MATCHES = 20  # candidates; of fewer, five rays fit too many by chance
MIN_SHARE = 0.3  # of the candidates that agree
SIGMA = 2.0  # px of the detection level: detectors attain 0.3, the rest is distortion that is not known yet
SAMPLES = 64  # find an orientation with 40 % of wrong candidates in 99.4 % of cases
NEIGHBOURS = 10  # stations: three strips of a block at 60 % side overlap


class View(NamedTuple):
    """What a pair needs of an image."""

    features: Features
    interior: Float[np.ndarray, "5"]
    """Principal distance, x0, y0 in px, 1 and -1: elements of the model without distortion."""
    station: Float[np.ndarray, "3"] | None
    """m."""


Pairs = dict[tuple[int, int], Int[np.ndarray, "match 2"]]


def neighbours(views: Sequence[View]) -> list[tuple[int, int]]:
    """Pairs of images that may overlap: all, or those of near stations where every image has one."""
    count = len(views)
    every = [(i, j) for i in range(count) for j in range(i + 1, count)]
    stations = [view.station for view in views if view.station is not None]
    if len(stations) < count or count <= NEIGHBOURS:
        return every
    centre = np.array(stations)[:, :2]
    squared = ((centre[:, None] - centre) ** 2).sum(2)
    near = np.argsort(squared, 1, kind="stable")[:, 1 : NEIGHBOURS + 1]
    return sorted({(min(i, int(j)), max(i, int(j))) for i in range(count) for j in near[i]})


def verified_pairs(
    views: Sequence[View], scale: float, done: Callable[[int, int], None] = lambda number, total: None
) -> Pairs:
    """Matches of all pairs that fit a relative orientation.

    Args:
        views: the images.
        scale: px of level 0 in a px of the level of the features.
        done: called after each pair with its number and the number of all.
    """
    pairs, found = neighbours(views), {}
    for number, (i, j) in enumerate(pairs):
        matches = verified(views[i], views[j], SIGMA * scale)
        if len(matches):
            found[i, j] = matches
        done(number + 1, len(pairs))
    return found


def verified(first: View, second: View, sigma: float) -> Int[np.ndarray, "match 2"]:
    """Candidates of two images that fit their relative orientation; none where too few do."""
    pairs = candidates(first.features.descriptors, second.features.descriptors)
    if len(pairs) < MIN_MATCHES:
        return pairs[:0]
    if len(pairs) > ROWS:
        pairs = pairs[np.linspace(0, len(pairs) - 1, ROWS).astype(int)]
    xy = np.zeros((2, ROWS, 2))
    xy[0, : len(pairs)] = first.features.xy[pairs[:, 0]]
    xy[1, : len(pairs)] = second.features.xy[pairs[:, 1]]
    sigmas = np.full((ROWS, 2), np.inf)
    sigmas[: len(pairs)] = sigma
    model = CAMERA_MODELS["none"]
    oriented = relative_orientation(
        model, first.interior, xy[0], xy[1], sigmas, second_camera=(model, second.interior), samples=SAMPLES
    )
    used = np.asarray(oriented.used)[: len(pairs)]
    enough = used.sum() >= max(MIN_MATCHES, MIN_SHARE * len(pairs))
    return pairs[used] if enough else pairs[:0]
