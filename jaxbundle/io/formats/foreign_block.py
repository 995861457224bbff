"""Types for the content of a file of another program: all readers return them and all writers accept them.

Conventions are those of this package: rotations are object_from_image (x right, y up, z back), image coordinates
in px from the top left corner with v down, or in mm from the image centre with y up. Unknown values are NaN.
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
    """A camera: model, elements by name (absent: 0; pixel_size: 1), estimated elements, and image format."""

    name: str
    model: CameraModel
    elements: Mapping[str, float]
    estimate: tuple[str, ...] = ()
    image_unit: str = "px"
    width: int | None = None
    height: int | None = None


class Images(NamedTuple):
    """Photographs with their orientations; NaN where an orientation is unknown."""

    names: tuple[str, ...]
    camera: Int[np.ndarray, " image"]
    rotation: Float[np.ndarray, "image 3 3"]
    """object_from_image."""
    centre: Float[np.ndarray, "image 3"]

    @property
    def oriented(self) -> Bool[np.ndarray, " image"]:
        """Mask of the images that have an orientation."""
        return np.asarray(np.isfinite(self.rotation).all((1, 2)) & np.isfinite(self.centre).all(1))


class Points(NamedTuple):
    """Object points with their coordinates; NaN where unknown."""

    names: tuple[str, ...]
    coordinates: Float[np.ndarray, "point 3"]


class RayTable(NamedTuple):
    """Measured image points with the numbers of their image and point."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    xy: Float[np.ndarray, "ray 2"]
    sigma: Float[np.ndarray, " ray"] | None = None
    """Standard deviations in the unit of the rays; None where the format has none."""


class Known(NamedTuple):
    """Known coordinates of an object point or a projection centre; NaN or an infinite sigma means not observed."""

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
    """A block as written by another program."""

    format: str
    """Name of the format, such as "COLMAP model"."""
    name: str
    cameras: tuple[ForeignCamera, ...]
    images: Images
    points: Points
    rays: RayTable
    control: tuple[Known, ...] = ()
    stations: tuple[Known, ...] = ()
    attitudes: tuple[Known, ...] = ()
    """Rows with the angles omega, phi, kappa in radians instead of coordinates."""
    distances: tuple[Distance, ...] = ()
    coordinate_system: str = ""
    """Text of the coordinate reference system in the file."""
    arbitrary: bool = False
    """Whether origin, axes and scale of the object system are arbitrary."""
    sigma: float = 1.0
    """Default standard deviation of image coordinates, in the unit of the rays, for files without one."""
    assumptions: tuple[str, ...] = ()
    """Assumptions about unknown values, each the end of a sentence "assumed that ..."."""
    findings: tuple[Finding, ...] = ()
    alternatives: tuple["Alternative", ...] = field(default=(), repr=False)
    """Other interpretations of the same file that its grammar allows."""
    reading: str = ""
    """Assumptions of this interpretation, where there are others."""


class Alternative(NamedTuple):
    """Another interpretation of a file, in words such as "matrix transposed"."""

    words: str
    changed: Callable[[ForeignBlock], ForeignBlock]


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """The vector of three numbers."""
    x, y, z = values
    return float(x), float(y), float(z)


def element(camera: ForeignCamera, name: str) -> float:
    """The value of an interior element; absent elements are 0, the pixel size 1, the axis -1 where v points down."""
    absent = {"pixel_size": 1.0, "y_axis": -1.0 if camera.image_unit == "px" else 1.0}
    return float(camera.elements.get(name, absent.get(name, 0.0)))


class ReadOptions(NamedTuple):
    """Information from the user that a file does not contain."""

    image_size: tuple[int, int] | None = None
    """Width and height of the images in px, for formats without it, or with the size of reduced images."""
    interior: tuple[float, float, float] | None = None
    """Principal distance and principal point in px, for formats without an interior orientation."""
    pixel_size: float | None = None
    """mm per px, for formats in mm without a pixel size."""
    chunk: str = ""
    """Label of the chunk to read from a Metashape project with several chunks."""


DEFAULT = ReadOptions()
