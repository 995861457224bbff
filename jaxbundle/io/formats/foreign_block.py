"""What a file of another program tells, before it is a block: the types that every reader fills and every writer takes.

Conventions are those of the package already: rotations are object_from_image (x right, y up, z back), image coordinates
in px from the top left corner with v down, or in mm from the image centre with y up. What is not known is NaN.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.findings import Finding
from jaxbundle.camera.model import CameraModel


@dataclass(frozen=True)
class ForeignCamera:
    """A camera: its model, elements by name (absent: 0; pixel_size: 1), those the program estimates, and its format."""

    name: str
    model: CameraModel
    elements: Mapping[str, float]
    estimate: tuple[str, ...] = ()
    image_unit: str = "px"
    width: int | None = None
    height: int | None = None


class Images(NamedTuple):
    """Photographs; NaN where an orientation is not known."""

    names: tuple[str, ...]
    camera: Int[np.ndarray, " image"]
    rotation: Float[np.ndarray, "image 3 3"]
    """object_from_image."""
    centre: Float[np.ndarray, "image 3"]

    @property
    def oriented(self) -> Bool[np.ndarray, " image"]:
        """Which images have an orientation."""
        return np.asarray(np.isfinite(self.rotation).all((1, 2)) & np.isfinite(self.centre).all(1))


class Points(NamedTuple):
    """Object points; NaN where coordinates are not known."""

    names: tuple[str, ...]
    coordinates: Float[np.ndarray, "point 3"]


class RayTable(NamedTuple):
    """Measured image points by the numbers of their image and point."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    xy: Float[np.ndarray, "ray 2"]
    sigma: Float[np.ndarray, " ray"] | None = None
    """Standard deviations in the unit of the rays; None where the format has none."""


class Known(NamedTuple):
    """Known coordinates of an object point or a projection centre: NaN, or an infinite sigma, is not observed."""

    name: str
    coordinates: tuple[float, float, float]
    sigmas: tuple[float, float, float]
    check: bool = False


class Distance(NamedTuple):
    """An observed distance between two object points."""

    start: str
    end: str
    distance: float
    sigma: float


@dataclass(frozen=True, eq=False)
class ForeignBlock:
    """A block as another program wrote it."""

    format: str
    """What the file is, such as "COLMAP model"."""
    name: str
    cameras: tuple[ForeignCamera, ...]
    images: Images
    points: Points
    rays: RayTable
    control: tuple[Known, ...] = ()
    stations: tuple[Known, ...] = ()
    attitudes: tuple[Known, ...] = ()
    """Angles omega, phi, kappa in radians in the place of coordinates."""
    distances: tuple[Distance, ...] = ()
    coordinate_system: str = ""
    """Text of the coordinate reference system as the file has it."""
    arbitrary: bool = False
    """Whether origin, axes and scale of the object system mean nothing."""
    sigma: float = 1.0
    """Standard deviation of image coordinates, unit of the rays, where the file has none."""
    assumptions: tuple[str, ...] = ()
    """What the file does not tell and was assumed, each the end of "Assumed: "."""
    findings: tuple[Finding, ...] = ()
    alternatives: tuple["Alternative", ...] = field(default=(), repr=False)
    """Other readings of the same file that its grammar allows."""
    reading: str = ""
    """What this reading takes for granted, where there are others."""


class Alternative(NamedTuple):
    """Another reading of a file, in words such as "matrix transposed"."""

    words: str
    changed: Callable[[ForeignBlock], ForeignBlock]


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers."""
    x, y, z = values
    return float(x), float(y), float(z)


def element(camera: ForeignCamera, name: str) -> float:
    """An interior element; what is absent is 0, of the pixel size 1, of the axis -1 where v points down."""
    absent = {"pixel_size": 1.0, "y_axis": -1.0 if camera.image_unit == "px" else 1.0}
    return float(camera.elements.get(name, absent.get(name, 0.0)))


class ReadOptions(NamedTuple):
    """What a user tells of a file that does not tell it itself."""

    image_size: tuple[int, int] | None = None
    """Width and height of the images in px, of formats that have none or have that of reduced images."""
    interior: tuple[float, float, float] | None = None
    """Principal distance and principal point in px, of formats without an interior orientation."""
    pixel_size: float | None = None
    """mm per px, of formats whose image coordinates are in mm without one."""
    chunk: str = ""
    """Label of the chunk to be read of a Metashape project with several."""


DEFAULT = ReadOptions()
