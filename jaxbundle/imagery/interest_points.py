"""Interest points with descriptors: SIFT of OpenCV (Lowe 2004), spread evenly over the image.

OpenCV counts from the centre of the first pixel, so 0.5 px are added. Without its precise upscaling its points are off
by a quarter of a pixel. Of keypoints at one place, which differ in orientation, the strongest is taken, so that a place
belongs to one track.
"""

import zipfile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.imagery.extra import required
from jaxbundle.imagery.levels import between_levels
from jaxbundle.imagery.pyramid_file import Pyramid
from jaxbundle.numerics.whole_files import write_whole

VERSION = 1  # of what is kept
PLACES = 8  # by 8 places of an image: finer than the 3 x 3 of von Gruber, so that distortion is determined too
NUMBER = 2048
CONTRAST = 0.01  # of SIFT; a quarter of its default, since weak texture is chosen per place
CENTRE = 0.5  # px: the centre of the first pixel


class Features(NamedTuple):
    """Interest points of an image."""

    xy: Float[np.ndarray, "feature 2"]
    """px of level 0."""
    descriptors: Float[np.ndarray, "feature 128"]
    """Square roots of the histograms, of unit length (Arandjelovic, Zisserman 2012)."""


def eight_bit(grey: Float[np.ndarray, "row column"]) -> np.ndarray:
    """Grey values from 0 to 255: those of 8 bit as they are, others stretched."""
    largest = grey.max(initial=0.0)
    return np.clip(np.round(grey * (255 / largest if largest > 255 else 1.0)), 0, 255).astype(np.uint8)


def features(image: Pyramid, level: int = 1, number: int = NUMBER) -> Features:
    """The strongest interest points of each place of an image.

    Args:
        image: its pyramid.
        level: on which they are found; half the resolution is where most programs find the best tie points.
        number: the largest number of points, spread over 8 x 8 places.
    """
    cv2 = required("cv2")
    level = min(level, len(image.sizes) - 1)
    picture = eight_bit(image.grey(level))
    detector = cv2.SIFT_create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
    keypoints = detector.detect(picture, None)
    if not keypoints:
        return Features(np.zeros((0, 2)), np.zeros((0, 128)))
    xy = np.array([k.pt for k in keypoints]) + CENTRE
    chosen = spread(xy, np.array([k.response for k in keypoints]), picture.shape, number)
    kept, descriptors = detector.compute(picture, [keypoints[k] for k in chosen])
    xy = np.array([k.pt for k in kept]).reshape(-1, 2) + CENTRE
    descriptors = np.asarray(descriptors, float).reshape(-1, 128)
    rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-12))
    return Features(between_levels(xy, level, 0), rooted.astype(np.float32))


def kept_features(image: Pyramid, level: int = 1, number: int = NUMBER) -> Features:
    """As `features`; they are kept beside the pyramid, so that an interrupted measurement goes on from them."""
    status = image.path.stat()
    key = f"{VERSION} {status.st_size} {status.st_mtime_ns} {level} {number}"
    file = image.path.with_suffix(".features.npz")
    try:
        with np.load(file) as kept:
            if str(kept["key"]) == key:
                return Features(kept["xy"], kept["descriptors"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        pass  # there are none, or not whole ones
    found = features(image, level, number)
    write_whole(file, lambda opened: np.savez(opened, key=key, xy=found.xy, descriptors=found.descriptors))
    return found


def spread(
    xy: Float[np.ndarray, "feature 2"], strength: Float[np.ndarray, " feature"], shape: tuple[int, ...], number: int
) -> np.ndarray:
    """Numbers of the strongest points of each place of an image, one of several at one position.

    Args:
        xy: positions in px.
        strength: the larger the better.
        shape: rows and columns of the image.
        number: the largest number of points.
    """
    order = np.argsort(-strength, kind="stable")
    _, first = np.unique(np.round(xy[order], 2), axis=0, return_index=True)
    order = order[np.sort(first)]
    column, row = (np.clip(xy[order] / shape[1::-1] * PLACES, 0, PLACES - 1).astype(int)).T
    place = row * PLACES + column
    by_place = np.argsort(place, kind="stable")
    counts = np.bincount(place, minlength=PLACES**2)
    rank = np.empty(len(order), int)
    rank[by_place] = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    return order[np.lexsort((np.arange(len(order)), rank))][:number]


def empty_places(xy: Float[np.ndarray, "feature 2"], rows: int, columns: int, places: int = 3) -> int:
    """How many of the places of von Gruber (3 x 3) of an image have no point."""
    column, row = (np.clip(xy / (columns, rows) * places, 0, places - 1).astype(int)).reshape(-1, 2).T
    return places**2 - len(np.unique(row * places + column))
