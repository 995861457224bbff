"""Interest points with descriptors: SIFT of OpenCV (Lowe 2004), spread evenly over the image.

OpenCV counts from the centre of the first pixel, so 0.5 px are added. Without its precise upscaling its points have
errors of a quarter of a pixel. From keypoints at one position, which differ in orientation, the strongest is used, so
that a position belongs to one track.
"""

import zipfile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.imagery.extra import required
from jaxbundle.imagery.levels import between_levels
from jaxbundle.imagery.pyramid_file import Pyramid
from jaxbundle.numerics.whole_files import write_whole

VERSION = 1  # number of detected points per selected point
PLACES = 8  # 8 x 8 regions of an image: finer than the 3 x 3 of von Gruber, so that distortion is also determined
NUMBER = 2048
CONTRAST = 0.01  # threshold of SIFT; a quarter of its default, since points are selected per region
CENTRE = 0.5  # px: the centre of the first pixel


class Features(NamedTuple):
    """Interest points of one image."""

    xy: Float[np.ndarray, "feature 2"]
    """px of level 0."""
    descriptors: Float[np.ndarray, "feature 128"]
    """Square roots of the histograms, with unit length (Arandjelovic, Zisserman 2012)."""


def eight_bit(grey: Float[np.ndarray, "row column"]) -> np.ndarray:
    """Grey values from 0 to 255: 8 bit values are unchanged, others are scaled."""
    largest = grey.max(initial=0.0)
    return np.clip(np.round(grey * (255 / largest if largest > 255 else 1.0)), 0, 255).astype(np.uint8)


def features(image: Pyramid, level: int = 1, number: int = NUMBER) -> Features:
    """Finds the strongest interest points of each region of an image.

    Args:
        image: its pyramid.
        level: level of the detection; most programs find the best tie points at half the resolution.
        number: the maximum number of points, spread over 8 x 8 regions.
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
    """Like `features`, but results are saved next to the pyramid, so that an interrupted measurement can resume."""
    status = image.path.stat()
    key = f"{VERSION} {status.st_size} {status.st_mtime_ns} {level} {number}"
    file = image.path.with_suffix(".features.npz")
    try:
        with np.load(file) as kept:
            if str(kept["key"]) == key:
                return Features(kept["xy"], kept["descriptors"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        pass  # there is no file, or it is incomplete
    found = features(image, level, number)
    write_whole(file, lambda opened: np.savez(opened, key=key, xy=found.xy, descriptors=found.descriptors))
    return found


def spread(
    xy: Float[np.ndarray, "feature 2"], strength: Float[np.ndarray, " feature"], shape: tuple[int, ...], number: int
) -> np.ndarray:
    """Indices of the strongest points of each region of an image, one of several at one position.

    Args:
        xy: positions in px.
        strength: the larger the better.
        shape: rows and columns of the image.
        number: the maximum number of points.
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
    """Number of the regions of von Gruber (3 x 3) of an image without points."""
    column, row = (np.clip(xy / (columns, rows) * places, 0, places - 1).astype(int)).reshape(-1, 2).T
    return places**2 - len(np.unique(row * places + column))
