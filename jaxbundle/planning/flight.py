"""An aerial flight: its camera, where images are taken from, and where the points lie they show.

Strips are flown along X, every second one back. Tie points lie on a shaken grid, control points in rows across the
strips: one row at either end, the others at equal distances between.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.camera.additional_parameters import GRID_SHARE
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.model import CameraModel
from jaxbundle.camera.registry import CAMERA_MODELS

SHAKE = 0.35  # of the grid's spacing, either way
ROW_REACH = 0.35  # of an image's height: the rows of control end so far outside the axes of the outer strips
SCATTER = 0.01  # of the flying height: stations off their places


@dataclass(frozen=True)
class AerialCamera:
    """A camera and its true interior. Lengths in mm; a camera with a pixel size is measured in px.

    `offset`: principal point from the centre of the format, x right, y up. `distortion` names the camera model; unless
    given, it is "brown" with `coefficients`, else "none". Elements in `estimate` are unknown and start from the centre
    of the format, from coefficients 0 and from a principal distance 0.2 % too long.
    """

    principal_distance: float = 153.0
    width: float = 230.0
    height: float = 230.0
    pixel_size: float | None = None
    offset: tuple[float, float] = (0.0, 0.0)
    coefficients: Mapping[str, float] = field(default_factory=dict)
    estimate: tuple[str, ...] = ()
    distortion: str | None = None

    @property
    def model(self) -> CameraModel:
        """The camera model.

        Raises: ValueError for one that is unknown.
        """
        if self.distortion is None:
            plain = set(self.coefficients) | set(self.estimate) <= set(DISTORTION_FREE.elements)
            return DISTORTION_FREE if plain else BROWN
        if self.distortion not in CAMERA_MODELS:
            raise ValueError(f"no camera model '{self.distortion}'; there are {', '.join(CAMERA_MODELS)}")
        return CAMERA_MODELS[self.distortion]

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of the format, unit and axes of the rays."""
        s = self.pixel_size
        return (self.width / 2 / s, self.height / 2 / s) if s else (0.0, 0.0)

    def interior(self) -> dict[str, float]:
        """True interior elements in the order of the model."""
        s, y_axis = (self.pixel_size, -1.0) if self.pixel_size else (1.0, 1.0)
        (x, y), (dx, dy) = self.centre, self.offset
        given = {"x0": x + dx / s, "y0": y + y_axis * dy / s, "pixel_size": s, "y_axis": y_axis}
        given |= {"grid_base": GRID_SHARE * max(self.width, self.height), **self.coefficients}
        given["principal_distance"] = self.principal_distance
        return {element: given.get(element, 0.0) for element in self.model.elements}


FRAME_CAMERA = AerialCamera()


class Flight(NamedTuple):
    """Nominal stations lie at (k base, strip distance times strip, height); footprint on the mean ground."""

    strips: int
    images: int
    base: float
    strip_distance: float
    footprint: tuple[float, float]
    height: float


class Incidence(NamedTuple):
    """Which image sees which point."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]


def flight_of(strips: int, images: int, camera: AerialCamera, height: float, overlaps: tuple[float, float]) -> Flight:
    """The flight with forward and side overlap, as shares of an image.

    Raises: ValueError for a flight whose images have no points in common, or an interior element nobody knows.
    """
    if strips < 1 or images < 2:
        raise ValueError(f"{strips} strips of {images} images; a block needs 1 strip of 2 images at least")
    if not all(0 <= overlap < 1 for overlap in overlaps) or overlaps[0] < 0.5:
        raise ValueError(f"overlaps {overlaps}; forward overlap is from 0.5 to below 1, side overlap from 0 to below 1")
    model = camera.model
    unknown = [name for name in camera.coefficients if name not in model.elements]
    unknown += [name for name in camera.estimate if name not in model.estimable]
    if unknown:
        raise ValueError(f"no interior element {', '.join(unknown)}; there are {', '.join(model.estimable)}")
    scale = height / camera.principal_distance
    along, across = scale * camera.width, scale * camera.height
    return Flight(strips, images, (1 - overlaps[0]) * along, (1 - overlaps[1]) * across, (along, across), height)


def stations(
    flight: Flight, tilt: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "image 3"], Float[np.ndarray, "image 3"]]:
    """Projection centres and omega, phi, kappa in the order of flight; every second strip is flown back."""
    strip, k = np.divmod(np.arange(flight.strips * flight.images), flight.images)
    back = strip % 2 == 1
    along = np.where(back, flight.images - 1 - k, k)
    nominal = np.c_[along * flight.base, strip * flight.strip_distance, np.full(len(k), flight.height)]
    centres = nominal + SCATTER * flight.height * rng.standard_normal(nominal.shape)
    angles = tilt * rng.standard_normal(nominal.shape)
    angles[back, 2] += math.pi
    return centres, angles


def control_points(flight: Flight, rows: int) -> Float[np.ndarray, "control 3"]:
    """Rows across the strips, from the first to the last stations; one point a strip and one more in each."""
    reach = ROW_REACH * flight.footprint[1]
    x = np.linspace(0, (flight.images - 1) * flight.base, rows)
    y = np.linspace(-reach, (flight.strips - 1) * flight.strip_distance + reach, flight.strips + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(x, y, indexing="ij"))
    return np.c_[x, y, np.zeros(len(x))]


def tie_points(flight: Flight, points_per_image: int, rng: np.random.Generator) -> Float[np.ndarray, "tie 3"]:
    """A shaken grid over all that the images cover."""
    along, across = flight.footprint
    spacing = math.sqrt(along * across / points_per_image)
    x = np.arange(-along / 2, (flight.images - 1) * flight.base + along / 2, spacing)
    y = np.arange(-across / 2, (flight.strips - 1) * flight.strip_distance + across / 2, spacing)
    x, y = (grid.ravel() for grid in np.meshgrid(x, y, indexing="ij"))
    shake = SHAKE * spacing * rng.uniform(-1, 1, (2, len(x)))
    return np.c_[x + shake[0], y + shake[1], np.zeros(len(x))]


def near_pairs(flight: Flight, points: Float[np.ndarray, "point 3"], relief: float, tilt: float) -> Incidence:
    """Every pair of image and point that may see each other: stations within an image's reach of the point."""
    swing = 4 * (tilt + SCATTER)
    share = 0.5 + relief / 2 / flight.height + swing
    along, across = (share * extent + swing * flight.height for extent in flight.footprint)
    k, s = _steps(along, flight.base), _steps(across, flight.strip_distance)
    along = np.round(points[:, 0] / flight.base).astype(int)[:, None, None] + k[:, None]
    strip = np.round(points[:, 1] / flight.strip_distance).astype(int)[:, None, None] + s
    along, strip = np.broadcast_arrays(along, strip)
    flown = (along >= 0) & (along < flight.images) & (strip >= 0) & (strip < flight.strips)
    point = np.nonzero(flown)[0]
    along, strip = along[flown], strip[flown]
    image = strip * flight.images + np.where(strip % 2 == 1, flight.images - 1 - along, along)
    order = np.lexsort((point, image))
    return Incidence(image[order].astype(np.int32), point[order].astype(np.int32))


def _steps(reach: float, spacing: float) -> Int[np.ndarray, " step"]:
    """Numbers of stations, either way from the nearest one, that lie within reach."""
    most = math.floor(reach / spacing + 0.5)
    return np.arange(-most, most + 1)
