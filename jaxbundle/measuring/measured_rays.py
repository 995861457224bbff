"""Measuring rays of tracks: all rays of a track with one template, on increasingly fine levels of the pyramids."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.imagery.match_types import MatchOptions, Refusal
from jaxbundle.imagery.ray_sigmas import ray_sigmas
from jaxbundle.imagery.tracks import Tracks, local_affine
from jaxbundle.imagery.window_pairs import PairTable, match_pairs
from jaxbundle.imagery.windows import GreyImages

COARSE = MatchOptions(min_correlation=0.6)  # options of a level before a finer one
FINE = MatchOptions()


class MeasuredRays(NamedTuple):
    """Measured rays of points on at least two images."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    xy: Float[np.ndarray, "ray 2"]
    """Coordinates in px of level 0."""
    sigmas: Float[np.ndarray, "ray 2"]
    refused: dict[Refusal, int]
    """Number of tried rays that were left out, for each reason."""


def measured_rays(
    images: GreyImages, found: Tracks, features: Sequence[Float[np.ndarray, "_feature 2"]], level: int
) -> MeasuredRays:
    """Measures tracks from the positions of a detector.

    Args:
        images: the pyramids.
        found: the tracks.
        features: features of each image with their positions.
        level: level of the detection.
    """
    xy = np.zeros((len(found.image), 2))
    for image in np.unique(found.image):
        own = found.image == image
        xy[own] = features[image][found.feature[own]]
    template, ray = _pairs(found, xy, features)
    pairs = PairTable(found.image[template], found.image[ray], xy[template], xy[ray], _affine(found, xy, template, ray))
    matches = None
    for k in range(level, -1, -1):
        matches = match_pairs(images, pairs, k, FINE if k == 0 else COARSE)
        pairs = pairs._replace(predicted=matches.position)
    assert matches is not None, "level 0 exists"
    good, points = matches.matched, int(found.point.max(initial=-1)) + 1
    own, of_templates = ray_sigmas(matches.covariance, good, found.point[ray], points)
    templates = np.unique(template[good])
    rows = np.concatenate([templates, ray[good]])
    positions = np.concatenate([xy[templates], matches.position[good]])
    sigmas = np.concatenate([of_templates[found.point[templates]], own[good]])
    order = np.lexsort((found.image[rows], found.point[rows]))
    point = np.unique(found.point[rows][order], return_inverse=True)[1]
    refused = {reason: int((matches.status == reason).sum()) for reason in Refusal if reason != Refusal.MATCHED}
    return MeasuredRays(found.image[rows][order], point, positions[order], sigmas[order], refused)


def _pairs(
    found: Tracks, xy: Float[np.ndarray, "ray 2"], features: Sequence[np.ndarray]
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Rays of templates, nearest to the centre of their image, and the others, sorted by the templates' images."""
    middle = np.array([(f.min(0) + f.max(0)) / 2 if len(f) else [0.0, 0.0] for f in features])
    away = ((xy - middle[found.image]) ** 2).sum(1)
    order = np.lexsort((away, found.point))
    first = np.ones(len(order), bool)
    first[1:] = found.point[order][1:] != found.point[order][:-1]
    template = order[first][np.cumsum(first) - 1]
    template, ray = template[~first], order[~first]
    by_image = np.lexsort((found.image[ray], found.image[template]))
    return template[by_image], ray[by_image]


def _affine(
    found: Tracks, xy: Float[np.ndarray, "ray 2"], template: Int[np.ndarray, " pair"], ray: Int[np.ndarray, " pair"]
) -> Float[np.ndarray, "pair 2 2"]:
    """Derivatives from neighbouring common points of both images."""
    affine = np.full((len(ray), 2, 2), np.nan)
    both = found.image[template].astype(np.int64) * (int(found.image.max(initial=0)) + 1) + found.image[ray]
    rays_of = {int(image): np.flatnonzero(found.image == image) for image in np.unique(found.image)}
    for key in np.unique(both):
        own = np.flatnonzero(both == key)
        one, other = (rays_of[int(found.image[rays[own[0]]])] for rays in (template, ray))
        _, i, j = np.intersect1d(found.point[one], found.point[other], return_indices=True)
        affine[own] = local_affine(xy[one[i]], xy[other[j]], xy[template[own]])
    return affine
