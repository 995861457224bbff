"""Positions on the ellipsoid of WGS 84 in a topocentric system: east, north, up at a point.

N = a / sqrt(1 - e^2 sin^2 B)
x = (N + h) cos B cos L,  y = (N + h) cos B sin L,  z = (N (1 - e^2) + h) sin B
"""

import numpy as np
from jaxtyping import Float

SEMI_MAJOR, FLATTENING = 6_378_137.0, 1 / 298.257223563  # m; WGS 84
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)


def geocentric(positions: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    """Cartesian coordinates in m of latitude, longitude (deg) and ellipsoidal height (m)."""
    b, l = np.radians(positions[:, :2]).T  # noqa: E741
    h = positions[:, 2]
    n = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY_SQUARED * np.sin(b) ** 2)
    return np.stack(
        [
            (n + h) * np.cos(b) * np.cos(l),
            (n + h) * np.cos(b) * np.sin(l),
            (n * (1 - ECCENTRICITY_SQUARED) + h) * np.sin(b),
        ],
        1,
    )


def topocentric(
    positions: Float[np.ndarray, "point 3"], origin: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "point 3"]:
    """East, north, up in m from an origin.

    Args:
        positions: latitude, longitude in deg, height in m, one row per point.
        origin: latitude, longitude, height of the origin.
    """
    b, l = np.radians(origin[:2])  # noqa: E741
    east = [-np.sin(l), np.cos(l), 0.0]
    north = [-np.sin(b) * np.cos(l), -np.sin(b) * np.sin(l), np.cos(b)]
    up = [np.cos(b) * np.cos(l), np.cos(b) * np.sin(l), np.sin(b)]
    return (geocentric(positions) - geocentric(origin[None])) @ np.array([east, north, up]).T
