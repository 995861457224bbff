"""Geodetic observations: between object points, and between points and projection centres.

With (dX, dY, dZ) from the first to the second,

    distance               s = sqrt(dX^2 + dY^2 + dZ^2)
    horizontal distance    h = sqrt(dX^2 + dY^2)
    height difference      dZ
    azimuth                A = atan2(dX, dY)        clockwise from +Y
    direction              A - o                    o: orientation of the set, an unknown
    zenith angle           z = atan2(h, dZ)

and, with a sigma but without an observed value,

    scale bar              s - b                    b: length of the bar, an unknown that may have a prior
    plumb line             (dX, dY)
    plane                  (a x + b y + z - d) / sqrt(1 + a^2 + b^2)
    line                   the two distances of (x, y, z) from the line through (p, q, 0) along (a, b, 1)

where (x, y, z) = F^T (X - O) are coordinates in a fixed frame F at O. A plane is near its x-y plane, a line near its z
axis.

All refer to a local plane system: long lines must be reduced before the adjustment (Torge & Mueller 2012, ch. 6).
"""

from functools import cache

import jax
import jax.numpy as jnp

from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.geometry.rotation import Scalar

FRAME = ("X", "Y", "Z", "a1", "a2", "a3", "b1", "b2", "b3", "c1", "c2", "c3")  # O, then the rows of F


def position(entity: tuple) -> Vector:
    """Coordinates of an object point, or of the projection centre of an image."""
    x, y, z = entity[0] if len(entity) == 2 else entity
    return x, y, z


def _between(start: tuple, end: tuple) -> Vector:
    a, b = position(start), position(end)
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


def wrapped(angle: Scalar) -> Scalar:
    """An angle without full turns, in [-pi, pi]."""
    return angle - 2 * jnp.pi * jax.lax.stop_gradient(jnp.round(angle / (2 * jnp.pi)))


def _distance(start: tuple, end: tuple, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, dz = _between(start, end)
    return (jnp.sqrt(dx**2 + dy**2 + dz**2) - observed[0],)


def _horizontal_distance(start: tuple, end: tuple, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, _ = _between(start, end)
    return (jnp.sqrt(dx**2 + dy**2) - observed[0],)


def _height_difference(start: tuple, end: tuple, observed: tuple[Scalar]) -> tuple[Scalar]:
    return (_between(start, end)[2] - observed[0],)


def _azimuth(start: tuple, end: tuple, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, _ = _between(start, end)
    return (wrapped(jnp.arctan2(dx, dy) - observed[0]),)


def _direction(start: tuple, end: tuple, orientation: Scalar, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, _ = _between(start, end)
    return (wrapped(jnp.arctan2(dx, dy) - orientation - observed[0]),)


def _zenith_angle(start: tuple, end: tuple, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, dz = _between(start, end)
    return (wrapped(jnp.arctan2(jnp.sqrt(dx**2 + dy**2), dz) - observed[0]),)


def _scale_bar(start: tuple, end: tuple, length: Scalar, observed: tuple[Scalar]) -> tuple[Scalar]:
    dx, dy, dz = _between(start, end)
    return (jnp.sqrt(dx**2 + dy**2 + dz**2) - length - observed[0],)


def _plumb_line(lower: tuple, upper: tuple, observed: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    dx, dy, _ = _between(lower, upper)
    return dx - observed[0], dy - observed[1]


def _local(point: Vector, frame: tuple[Scalar, ...]) -> Vector:
    """F^T (X - O)."""
    rotation = frame[3], frame[4], frame[5], frame[6], frame[7], frame[8], frame[9], frame[10], frame[11]
    return photo_vector(rotation, (frame[0], frame[1], frame[2]), point)


def _plane(
    point: Vector, a: Scalar, b: Scalar, d: Scalar, observed: tuple[Scalar], frame: tuple[Scalar, ...]
) -> tuple[Scalar]:
    x, y, z = _local(point, frame)
    return ((a * x + b * y + z - d) / jnp.sqrt(1 + a**2 + b**2) - observed[0],)


def _line(
    point: Vector,
    a: Scalar,
    b: Scalar,
    p: Scalar,
    q: Scalar,
    observed: tuple[Scalar, Scalar],
    frame: tuple[Scalar, ...],
) -> tuple[Scalar, Scalar]:
    x, y, z = _local(point, frame)
    x, y = x - p, y - q
    # (1, 0, -a) and (-a b, 1 + a^2, -b) are orthogonal to (a, b, 1) and to each other
    one, two = jnp.sqrt(1 + a**2), jnp.sqrt((1 + a**2) * (1 + a**2 + b**2))
    return (x - a * z) / one - observed[0], ((1 + a**2) * y - a * b * x - b * z) / two - observed[1]


_BETWEEN = {
    "distances": (("distance",), _distance, ()),
    "horizontal_distances": (("distance",), _horizontal_distance, ()),
    "height_differences": (("difference",), _height_difference, ()),
    "azimuths": (("azimuth",), _azimuth, ()),
    "directions": (("direction",), _direction, ("parameter",)),
    "zenith_angles": (("angle",), _zenith_angle, ()),
    "scale_bars": (("length",), _scale_bar, ("parameter",)),
    "plumb_lines": (("dX", "dY"), _plumb_line, ()),
}
ANGLES = ("azimuths", "directions", "zenith_angles")  # internally observed in radians


@cache
def geodetic_kind(name: str, start: str = "point", end: str = "point") -> ObservationKind:
    """Returns a kind by the name of its table; `start` and `end` are "point" or "image".

    Raises: KeyError for an unknown name.

    Example:
        >>> jb.observations.geodetic_kind("distances", "point", "image").touches
        ('point', 'image')
    """
    components, residual, more = _BETWEEN[name]
    return ObservationKind(name, components, (start, end, *more), residual, angles=name in ANGLES)


DISTANCES = geodetic_kind("distances")
"""Observed distances between two points.

Example:
    >>> jb.observations.DISTANCES.touches
    ('point', 'point')
"""
PLANES = ObservationKind("planes", ("distance",), ("point", *["parameter"] * 3), _plane, constants=FRAME)
"""Points that lie in a plane.

Example:
    >>> jb.observations.PLANES.components
    ('distance',)
"""
LINES = ObservationKind("lines", ("across 1", "across 2"), ("point", *["parameter"] * 4), _line, constants=FRAME)
"""Points that lie on a straight line.

Example:
    >>> jb.observations.LINES.components
    ('across 1', 'across 2')
"""
