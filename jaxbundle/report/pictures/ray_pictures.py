"""Residuals of the rays: comparison with the normal distribution, by image, and mean field over the image format."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, ndtri

from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.known import known

BINS, WIDEST = 60, 6.0  # classes of a histogram, and the standardised residual of the outermost ones
QUANTILES = 101
CELLS = (24, 36)  # maximum number of rows and columns of a residual field
RAYS_OF_CELL = 12  # average number of rays per cell, so that the mean of a cell exceeds its noise
COVERAGE = 6  # rows and columns of the grid for the coverage of the format
INWARD = 1e-9  # residuals beyond the widest class are counted in the outermost class


class Histogram(NamedTuple):
    """Counts between edges, separate for x and y; values beyond the outermost edges are in the outermost classes."""

    edges: Float[np.ndarray, " edge"]
    counts: Int[np.ndarray, "component class"]


class Field(NamedTuple):
    """Mean residuals of a camera over its format. `ratio`: the mean divided by its standard deviation."""

    x: Float[np.ndarray, " cell"]
    y: Float[np.ndarray, " cell"]
    mean: Float[np.ndarray, "cell 2"]
    ratio: Float[np.ndarray, "cell 2"]
    rays: Int[np.ndarray, " cell"]
    format: tuple[float, float, float, float]
    unit: str
    probability: float
    """Probability of a larger sum of squared ratios if all means were zero."""


class ImageFigures(NamedTuple):
    """Statistics of the rays of each image: number, rms of vx and vy, rms and maximum of w / sigma0, coverage."""

    rays: Int[np.ndarray, " image"]
    rms: Float[np.ndarray, "image 2"]
    standardised: Float[np.ndarray, " image"]
    largest: Float[np.ndarray, " image"]
    coverage: Float[np.ndarray, " image"]


def standardised(
    figures: Figures, rays: Int[np.ndarray, " ray"] | slice = slice(None)
) -> Float[np.ndarray, "ray component"]:
    """Standardised residuals w / sigma0 of rays, normal for normal errors; v / (sigma0 sigma) without w."""
    numbers = figures.normalised[0] if figures.reliability is None else figures.reliability.w[0]
    scale = figures.sigma0 if figures.sigma0 > 0 else np.inf
    with np.errstate(all="ignore"):
        return known(numbers[rays] / scale)


def residual_histogram(figures: Figures) -> Histogram:
    """Histogram of the standardised residuals of the rays."""
    values = standardised(figures)
    edges = np.linspace(-WIDEST, WIDEST, BINS + 1)
    inside = np.clip(values, -WIDEST + INWARD, WIDEST - INWARD)
    counts = [np.histogram(column[np.isfinite(column)], edges)[0] for column in inside.T]
    return Histogram(edges, np.array(counts, int))


def normal_quantiles(figures: Figures) -> Float[np.ndarray, "quantile 2"]:
    """Quantiles of the normal distribution, and of all standardised residuals.

    The outermost quantile of each tail is the extreme residual.
    """
    values = standardised(figures)
    values = np.sort(values[np.isfinite(values)])
    if len(values) < 2:
        return np.zeros((0, 2))
    rank = np.unique(np.round(np.linspace(0, len(values) - 1, min(QUANTILES, len(values)))).astype(int))
    return np.stack([ndtri((rank + 0.5) / len(values)), values[rank]], 1)


def image_figures(figures: Figures) -> ImageFigures:
    """Statistics of the rays of each image."""
    structure, values = figures.structure, standardised(figures)
    image, count = structure.ray_image, len(structure.image_names)
    n = figures.rays_of_image

    def mean_of(numbers: np.ndarray) -> np.ndarray:
        usable = np.isfinite(numbers)
        number = np.bincount(image, usable, count)
        return np.bincount(image, np.where(usable, numbers, 0.0), count) / np.where(number > 0, number, np.nan)

    with np.errstate(all="ignore"):
        rms = np.stack([np.sqrt(mean_of(known(v) ** 2)) for v in figures.residuals[0].T], 1)
        one = np.sqrt(np.stack([mean_of(w**2) for w in values.T], 1).mean(1))
    largest = np.zeros(count)
    np.maximum.at(largest, image, np.maximum(*np.nan_to_num(np.abs(values)).T))
    return ImageFigures(n, rms, one, np.where(n > 0, largest, np.nan), _coverage(figures))


def _coverage(figures: Figures) -> Float[np.ndarray, " image"]:
    """Share of the cells of the format that contain a ray."""
    structure = figures.structure
    formats = np.array([image_format(figures, c) for c in range(len(structure.cameras))])
    low, high = formats[structure.image_camera[structure.ray_image]].reshape(-1, 2, 2).transpose(1, 0, 2)
    xy = known(np.asarray(figures.adjustment.block.rays.coordinates))
    with np.errstate(all="ignore"):
        cell = np.clip(np.nan_to_num((xy - low) / (high - low)) * COVERAGE, 0, COVERAGE - 1).astype(int)
    code = (structure.ray_image.astype(int) * COVERAGE + cell[:, 0]) * COVERAGE + cell[:, 1]
    cells = np.bincount(code, minlength=len(structure.image_names) * COVERAGE**2)
    return (cells.reshape(-1, COVERAGE**2) > 0).mean(1)


def image_format(figures: Figures, camera: int) -> tuple[float, float, float, float]:
    """Left, low, right and high bound of the image coordinates: of the format if known, otherwise of the rays."""
    structure = figures.structure
    one = structure.cameras[camera]
    if one.image_unit == "px" and one.width and one.height:
        return 0.0, 0.0, float(one.width), float(one.height)
    xy = known(np.asarray(figures.adjustment.block.rays.coordinates)[structure.rays_of_camera[camera]])
    if not np.isfinite(xy).all(1).any():
        return 0.0, 0.0, 1.0, 1.0
    low, high = np.nanmin(xy, 0), np.nanmax(xy, 0)
    return float(low[0]), float(low[1]), float(max(high[0], low[0] + 1e-9)), float(max(high[1], low[1] + 1e-9))


def residual_field(figures: Figures, camera: int, bins: tuple[int, int] = CELLS) -> Field:
    """Mean residuals of a camera's rays in the cells of a grid over its format; with few rays the cells are larger."""
    structure = figures.structure
    rays = structure.rays_of_camera[camera]
    xy = known(np.asarray(figures.adjustment.block.rays.coordinates)[rays])
    v, w = known(figures.residuals[0][rays]), standardised(figures, rays)
    drawn = np.isfinite(xy).all(1) & np.isfinite(v).all(1)
    xy, v, w = xy[drawn], v[drawn], w[drawn]
    bounds = image_format(figures, camera)
    share = min(1.0, np.sqrt(max(len(v), 1) / RAYS_OF_CELL / (bins[0] * bins[1])))
    rows, columns = (max(3, int(n * share)) for n in bins)
    size = np.array([(bounds[2] - bounds[0]) / columns, (bounds[3] - bounds[1]) / rows])
    cell = np.clip((xy - bounds[:2]) / size, 0, [columns - 1, rows - 1]).astype(int)
    code = cell[:, 1] * columns + cell[:, 0]
    count = np.bincount(code, minlength=rows * columns)
    there = np.flatnonzero(count)
    mean, z = (
        np.stack([np.bincount(code, x, rows * columns) for x in np.nan_to_num(values).T], 1)[there] / count[there, None]
        for values in (v, w)
    )
    ratio = z * np.sqrt(count[there])[:, None]
    x, y = bounds[0] + (there % columns + 0.5) * size[0], bounds[1] + (there // columns + 0.5) * size[1]
    probability = float(chdtrc(2 * len(there), (ratio**2).sum())) if len(there) else float("nan")
    unit = structure.cameras[camera].image_unit
    return Field(x, y, mean, ratio, count[there], bounds, unit, probability)
