"""Signalised targets measured by least-squares matching with drawn templates."""

import numpy as np
from scipy import ndimage

from jaxbundle.imagery.match_types import MatchOptions
from jaxbundle.imagery.matching import match

HALF, RADIUS = 20, 14.0  # px: template of a disc
REACH, AROUND = 50, 34  # px around a mark: the searched window, and the part in which the disc is delimited
SOFT = 0.8  # px: width of the edges


def disc() -> np.ndarray:
    """A dark disc on a light ground."""
    x, y = np.meshgrid(np.arange(2 * HALF + 1) - HALF, np.arange(2 * HALF + 1) - HALF)
    return 200 - 180 / (1 + np.exp((np.hypot(x, y) - RADIUS) / SOFT))


def outline(image: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of a dark ellipse around a mark, and the symmetric map from the disc to it, from its moments."""
    column, row = at.astype(int)
    top, left = max(row - AROUND, 0), max(column - AROUND, 0)
    part = image[top : row + AROUND + 1, left : column + AROUND + 1]
    threshold = (part[row - top, column - left] + np.percentile(part, 90)) / 2
    labels = np.zeros(part.shape, int)
    ndimage.label(part < threshold, output=labels)
    y, x = np.nonzero(labels == labels[row - top, column - left])
    values, axes = np.linalg.eigh(np.cov(np.stack([x, y])))
    centre = np.array([x.mean() + left + 0.5, y.mean() + top + 0.5])
    return centre, axes @ np.diag(2 * np.sqrt(values) / RADIUS) @ axes.T


def discs(images: dict[str, np.ndarray], names: list[str], marks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions of discs near marks, and which of them were matched.

    A disc does not change if it is rotated, so its affine map is that of the moments and only its position is unknown.
    """
    found = [outline(images[name], at) for name, at in zip(names, marks, strict=True)]
    centre, affine = (np.array(x) for x in zip(*found, strict=True))
    border = REACH + 2
    padded = {name: np.pad(image, border, mode="edge") for name, image in images.items()}
    corner = np.floor(centre).astype(int) - REACH
    size = 2 * REACH + 1
    windows = [
        padded[name][y + border : y + border + size, x + border : x + border + size]
        for name, (x, y) in zip(names, corner, strict=True)
    ]
    start = centre - corner
    matches = match(
        np.tile(disc(), (len(names), 1, 1)),
        np.array(windows),
        np.full((len(names), 2), HALF + 0.5),
        np.concatenate([start[:, :1], affine[:, 0], start[:, 1:], affine[:, 1]], 1),
        MatchOptions(parameters="shift", max_shift=3.0),
    )
    return np.asarray(matches.position) + corner, matches.matched
