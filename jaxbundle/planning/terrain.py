"""Terrains from a formula or a grid of heights, as functions of X and Y for `Terrain.heights`."""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RegularGridInterpolator

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def waves(relief: float, wavelength: float) -> Heights:
    """Hills and hollows, relief/2 sin(2 pi X / L) sin(2 pi Y / L), in object units.

    Example:
        >>> round(float(jb.planning.waves(20.0, 400.0)(np.array(100.0), np.array(100.0))), 6)
        10.0
    """
    k = 2 * math.pi / wavelength
    return lambda x, y: relief / 2 * np.sin(k * x) * np.sin(k * y)


def slope(along_x: float, along_y: float) -> Heights:
    """A plane with these slopes along X and Y.

    Example:
        >>> float(jb.planning.slope(0.1, 0.0)(np.array(50.0), np.array(0.0)))
        5.0
    """
    return lambda x, y: along_x * x + along_y * y


def grid_heights(points: Float[np.ndarray, "point 3"]) -> Heights:
    """Bilinear interpolation of heights on a regular grid; outside the grid the heights of its edge.

    Args:
        points: X, Y, Z of all nodes, in any order.

    Raises: ValueError for points that are not the nodes of a grid with lines of equal X and equal Y.

    Example:
        >>> heights = jb.planning.grid_heights(np.array([[0, 0, 1], [0, 10, 1], [10, 0, 3], [10, 10, 3.0]]))
        >>> heights(np.array([5.0]), np.array([5.0]))
        array([2.])
    """
    x, y = np.unique(points[:, 0]), np.unique(points[:, 1])
    if len(x) < 2 or len(y) < 2 or len(points) != len(x) * len(y):
        what = f"{len(points)} heights on {len(x)} values of X and {len(y)} of Y are not a grid"
        raise ValueError(f"{what}; give a height for each X with each Y, at least 2 of both")
    z = np.full((len(x), len(y)), np.nan)
    z[np.searchsorted(x, points[:, 0]), np.searchsorted(y, points[:, 1])] = points[:, 2]
    if not np.isfinite(z).all():
        raise ValueError("the grid has nodes without a height; give a finite number for each node, each once")
    inside = RegularGridInterpolator((x, y), z)

    def heights(px: np.ndarray, py: np.ndarray) -> np.ndarray:
        return inside(np.c_[np.clip(px, x[0], x[-1]), np.clip(py, y[0], y[-1])])

    return heights
