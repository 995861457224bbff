"""Precision of the object points over the block, and as a function of the number of rays."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.known import known, limits

CELLS = 96  # maximum number of cells along the longer side of a map
MAX_RAYS = 12  # points with this number of rays or more are counted together
COMPONENTS = ("X", "Y", "Z")


class PrecisionMap(NamedTuple):
    """Median standard deviation in the cells of a grid over the block; NaN in empty cells.

    Row 0 has the minimum Y. `bounds`: minimum X, minimum Y, maximum X, maximum Y.
    """

    median: Float[np.ndarray, "row column"]
    bounds: tuple[float, float, float, float]


class RayCounts(NamedTuple):
    """Number of points and median sd in X, Y, Z for each number of rays; the last row includes larger numbers."""

    rays: Int[np.ndarray, " number"]
    points: Int[np.ndarray, " number"]
    median_sd: Float[np.ndarray, "number 3"]


def precision_map(figures: Figures, component: str = "Z", cells: int = CELLS) -> PrecisionMap:
    """The map of the points' standard deviation in X, Y or Z; with few points the cells are larger.

    Raises: ValueError for another component.
    """
    if component not in COMPONENTS:
        raise ValueError(f"component {component!r} is not one of {', '.join(COMPONENTS)}")
    points, sd = known(figures.points), known(figures.points_sd[:, COMPONENTS.index(component)])
    usable = np.isfinite(points).all(1) & (sd > 0)
    points, sd = points[usable], sd[usable]
    (west, east), (south, north) = limits(points[:, 0], 0.02), limits(points[:, 1], 0.02)
    number = int(np.clip(np.sqrt(len(sd)) / 1.5, 6, cells))
    size = max(east - west, north - south) / number
    columns, rows = (max(1, int(np.ceil(length / size))) for length in (east - west, north - south))
    cell = np.minimum((points[:, 1] - south) / size, rows - 1).astype(int) * columns
    cell += np.minimum((points[:, 0] - west) / size, columns - 1).astype(int)
    grid = _medians(cell, sd, rows * columns).reshape(rows, columns)
    return PrecisionMap(grid, (west, south, west + columns * size, south + rows * size))


def _medians(group: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """The median of each group, NaN for an empty group."""
    order = np.lexsort((values, group))
    count = np.bincount(group, minlength=groups)
    first = np.cumsum(count) - count
    medians, there = np.full(groups, np.nan), np.flatnonzero(count)
    ordered = values[order]
    low, high = (ordered[first[there] + (count[there] - k) // 2] for k in (1, 0))
    medians[there] = 0.5 * (low + high)
    return medians


def ray_counts(figures: Figures) -> RayCounts:
    """Number and precision of the points for each number of rays."""
    rays = np.minimum(figures.rays_of_point, MAX_RAYS)
    numbers = np.arange(1, MAX_RAYS + 1)
    sd = known(np.where(figures.structure.point_free, figures.points_sd, np.nan))
    medians = []
    for column in sd.T:
        usable = np.isfinite(column)
        medians.append(_medians(rays[usable], column[usable], MAX_RAYS + 1)[1:])
    return RayCounts(numbers, np.bincount(rays, minlength=MAX_RAYS + 1)[1:], np.stack(medians, 1))
