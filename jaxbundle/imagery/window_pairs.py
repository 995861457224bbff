"""Pairs of windows over many images: one template for all rays of a point, matched from a predicted position.

A point is measured in all images with the same template, so that its rays refer to one point of the terrain. If the
scales of two images differ, a higher pyramid level of the finer one is used.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.imagery.match_types import DEFAULT, MatchOptions, Refusal
from jaxbundle.imagery.matching import match
from jaxbundle.imagery.windows import GreyImages

HALF = 8  # px: windows of 17 x 17; larger ones are often not flat
MARGIN = 6  # px around the searched part: the effect of the spline's mirrored border is 0.27^6
MAX_SHIFT = 3.0  # px of the level: larger shifts exceed the pull-in range of a window of 17 px
TURNED = 1.2  # ratio of the distance of a window's corner and its half size: rotated and sheared windows, up to 1.7
AT_ONCE = 4096  # number of pairs with windows in memory
OTHER_LEVEL = 2**0.5  # ratio of scales above which another level is nearer


class PairTable(NamedTuple):
    """Pairs of windows, one row each; image coordinates in px of level 0."""

    template_image: Int[np.ndarray, " pair"]
    image: Int[np.ndarray, " pair"]
    template: Float[np.ndarray, "pair 2"]
    """The point in the template's image."""
    predicted: Float[np.ndarray, "pair 2"]
    """The predicted position in the other image."""
    affine: Float[np.ndarray, "pair 2 2"]
    """Predicted derivatives of coordinates in the image with respect to those in the template's image."""


class PairMatches(NamedTuple):
    """Positions in the other images, px of level 0, and reasons of refusals."""

    position: Float[np.ndarray, "pair 2"]
    """Position in the other image; the predicted one for a refused match."""
    covariance: Float[np.ndarray, "pair 2 2"]
    affine: Float[np.ndarray, "pair 2 2"]
    correlation: Float[np.ndarray, " pair"]
    status: Int[np.ndarray, " pair"]

    @property
    def matched(self) -> np.ndarray:
        """Mask of the accepted pairs."""
        return self.status == Refusal.MATCHED


def levels_of(
    affine: Float[np.ndarray, "pair 2 2"], level: int
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Levels of the template and of the other image at which both show the same details."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.sqrt(np.abs(np.linalg.det(affine)))
        finer = np.clip(np.nan_to_num(np.round(np.log2(scale))), -3, 3).astype(int)
    apart = (scale > OTHER_LEVEL) | (scale < 1 / OTHER_LEVEL)
    finer = np.where(apart, finer, 0)
    return level + np.maximum(-finer, 0), level + np.maximum(finer, 0)


def match_pairs(
    images: GreyImages, pairs: PairTable, level: int = 0, options: MatchOptions = DEFAULT, half: int = HALF
) -> PairMatches:
    """Matches pairs by least squares on one level of the pyramids.

    Args:
        images: the images by their indices.
        pairs: the pairs in any order; successive pairs with the same template image are fastest.
        level: level of the coarser image of each pair.
        options: as for `match`; the default of `max_shift` is 3 px of the level.
        half: the windows have 2 half + 1 px.
    """
    if options.max_shift is None:
        options = options._replace(max_shift=MAX_SHIFT)
    equal = np.array_split(np.arange(len(pairs.image)), -(-len(pairs.image) // AT_ONCE) or 1)
    parts = [_match(images, PairTable(*(x[own] for x in pairs)), level, options, half) for own in equal if len(own)]
    if not parts:
        nothing = np.zeros((0, 2, 2))
        return PairMatches(np.zeros((0, 2)), nothing, nothing, np.zeros(0), np.zeros(0, int))
    return PairMatches(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _match(images: GreyImages, pairs: PairTable, level: int, options: MatchOptions, half: int) -> PairMatches:
    level_of_template, level_of_image = levels_of(pairs.affine, level)
    templates = images.cut(pairs.template_image, level_of_template, pairs.template, half)
    reach = int(np.ceil(TURNED * half * OTHER_LEVEL + (options.max_shift or MAX_SHIFT))) + MARGIN
    searched = images.cut(pairs.image, level_of_image, pairs.predicted, reach)
    scale, back = 0.5 ** level_of_image[:, None], 2.0**level_of_image
    reference = pairs.template * 0.5 ** level_of_template[:, None] - templates.corner
    start = pairs.predicted * scale - searched.corner
    affine = pairs.affine * (2.0 ** (level_of_template - level_of_image))[:, None, None]
    starts = np.concatenate([start[:, :1], affine[:, 0], start[:, 1:], affine[:, 1]], 1)
    usable = templates.inside & searched.inside & np.isfinite(starts).all(1)
    starts[~usable] = 0.0
    reference[~usable] = 0.0
    found = match(templates.grey, searched.grey, reference, starts, options)
    status = np.where(usable, np.asarray(found.status), int(Refusal.NO_WINDOW))
    good = status == Refusal.MATCHED
    position = (np.asarray(found.position) + searched.corner) / scale
    back_of_template = 2.0 ** (level_of_template - level_of_image)
    return PairMatches(
        np.where(good[:, None], position, pairs.predicted),
        np.where(good[:, None, None], np.asarray(found.covariance) * (back**2)[:, None, None], np.nan),
        np.where(good[:, None, None], np.asarray(found.affine) / back_of_template[:, None, None], pairs.affine),
        np.asarray(found.correlation),
        status,
    )
