"""Verifying the candidates of pairs of images by the relative orientation."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.imagery.interest_points import Features
from jaxbundle.imagery.match_candidates import candidates
from jaxbundle.measuring.pair_files import VERSION, digest, store_pair, stored_pair
from jaxbundle.numerics.devices import on_cores
from jaxbundle.orientation.relative_orientations import relative_orientation

ROWS = 512  # maximum points of a relative orientation: one program for all pairs
MIN_MATCHES = 20  # minimum candidates; with fewer, too many fit five rays by chance
MIN_SHARE = 0.3  # minimum share of agreeing candidates
SIGMA = 2.0  # px of the detection level: detectors have 0.3, the rest is unknown distortion
SAMPLES = 64  # samples that find an orientation with 40 % wrong candidates in 99.4 % of cases
NEIGHBOURS = 10  # nearest stations: three strips of a block with 60 % side overlap


class View(NamedTuple):
    """Data of an image for pairs."""

    features: Features
    interior: Float[np.ndarray, "5"]
    """Interior elements of the model without distortion: principal distance, x0, y0 in px, 1 and -1."""
    station: Float[np.ndarray, "3"] | None
    """m."""
    name: str = ""
    """Name of the image, in the names of files of pairs."""


Pairs = dict[tuple[int, int], Int[np.ndarray, "_match 2"]]


def neighbours(views: Sequence[View]) -> list[tuple[int, int]]:
    """Pairs of images that may overlap: all, or those of near stations if each image has a station."""
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
    views: Sequence[View],
    scale: float,
    done: Callable[[int, int], None] = lambda number, total: None,
    folder: Path | None = None,
) -> Pairs:
    """Matches of all pairs that agree with a relative orientation; pairs are computed on all cores.

    Args:
        views: the images.
        scale: px of level 0 per px of the level of the features.
        done: a function that is called after each pair with its number and the total number.
        folder: folder of the finished pairs, which are not remeasured; None stores nothing.
    """
    pairs, found = neighbours(views), {}
    store = None if folder is None else _Store(folder, views, SIGMA * scale)

    def matches_of(pair: tuple[int, int]) -> Int[np.ndarray, "match 2"]:
        matches = None if store is None else store.matches(pair)
        if matches is None:
            matches = verified(views[pair[0]], views[pair[1]], SIGMA * scale)
            if store is not None:
                store.keep(pair, matches)
        return matches

    for number, (pair, matches) in enumerate(zip(pairs, on_cores(matches_of, pairs), strict=True)):
        if len(matches):
            found[pair] = matches
        done(number + 1, len(pairs))
    return found


class _Store:
    """Finished pairs in a folder; a pair counts if its points, cameras and options are the same."""

    def __init__(self, folder: Path, views: Sequence[View], sigma: float):
        self.folder, self.names = folder, [view.name for view in views]
        views_keys = [digest(view.features.xy, view.features.descriptors, view.interior) for view in views]
        self.key = lambda pair: f"{VERSION} {sigma} {SAMPLES} {views_keys[pair[0]]} {views_keys[pair[1]]}"

    def _file(self, pair: tuple[int, int]) -> Path:
        return self.folder / f"{self.names[pair[0]]}+{self.names[pair[1]]}.npz"

    def matches(self, pair: tuple[int, int]) -> Int[np.ndarray, "match 2"] | None:
        """The matches of a finished pair."""
        return stored_pair(self._file(pair), self.key(pair))

    def keep(self, pair: tuple[int, int], matches: Int[np.ndarray, "match 2"]) -> None:
        """Stores the matches of a pair."""
        store_pair(self._file(pair), self.key(pair), matches)


def verified(first: View, second: View, sigma: float) -> Int[np.ndarray, "match 2"]:
    """Candidates of two images that fit their relative orientation; none if there are too few."""
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
