"""Collecting the rows of text formats of aerial triangulation by names: photographs, points, rays, control."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.io.formats.foreign_block import ForeignBlock, ForeignCamera, Images, Known, Points, RayTable

# mm, of image coordinates where a format has none: half a pixel of scanned film, one pixel of most sensors
SIGMA = 0.005
IN_MM = "image coordinates have a standard deviation of 0.005 mm"
IN_PX = "image coordinates have a standard deviation of 1 px"
CONTROL = "control points have standard deviations of 0.05 m in plan and 0.1 m in height"
CONTROL_SIGMAS = (0.05, 0.05, 0.1)


class Collected:
    """Numbers for names, in the order of their first occurrence."""

    def __init__(self):
        self.images: dict[str, int] = {}
        self.points: dict[str, int] = {}
        self.camera: dict[str, str] = {}
        self.orientation: dict[str, tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]] = {}
        self.matrix: dict[str, Float[np.ndarray, "3 3"]] = {}
        self.coordinates: dict[str, tuple[float, float, float]] = {}
        self.control: dict[str, Known] = {}
        self.rays: list[tuple[int, int, float, float]] = []

    def image(self, name: str) -> int:
        """Returns the number of an image."""
        return self.images.setdefault(name, len(self.images))

    def ray(self, image: str, point: str, x: float, y: float) -> None:
        """Adds the ray of a measured point."""
        self.rays.append((self.image(image), self.points.setdefault(point, len(self.points)), x, y))

    def images_with(self, cameras: list[str], matrices: Callable[[np.ndarray], np.ndarray]) -> Images:
        """The images; `matrices` converts the collected rows of three angles to object_from_image."""
        names = tuple(self.images)
        rotation, centre = np.full((len(names), 3, 3), np.nan), np.full((len(names), 3), np.nan)
        some = [k for k, name in enumerate(names) if name in self.orientation]
        if some:
            rows = [self.orientation[names[k]] for k in some]
            centre[some] = [place for place, _ in rows]
            rotation[some] = matrices(np.array([angles for _, angles in rows]))
        for k, name in enumerate(names):
            if name in self.matrix:
                rotation[k] = self.matrix[name]
                centre[k] = self.orientation[name][0] if name in self.orientation else centre[k]
        number = {name: k for k, name in enumerate(cameras)}
        camera = np.array([number.get(self.camera.get(name, ""), 0) for name in names], np.int64)
        return Images(names, camera, rotation, centre)

    def points_found(self) -> Points:
        """The measured points, with the collected coordinates."""
        names = tuple(self.points)
        missing = (np.nan, np.nan, np.nan)
        return Points(names, np.array([self.coordinates.get(name, missing) for name in names], float).reshape(-1, 3))

    def ray_table(self) -> RayTable:
        """The rays of all images."""
        rays = np.array(self.rays, float).reshape(-1, 4)
        return RayTable(rays[:, 0].astype(np.int64), rays[:, 1].astype(np.int64), rays[:, 2:])

    def measured_control(self) -> tuple[Known, ...]:
        """The control points that are measured."""
        return tuple(self.control.values())


def mm_camera(name: str, c: float, x0: float = 0.0, y0: float = 0.0) -> ForeignCamera:
    """A camera without distortion, in mm from the image centre, y up."""
    return ForeignCamera(name, DISTORTION_FREE, {"principal_distance": c, "x0": x0, "y0": y0}, (), "mm")


def scaled(foreign: ForeignBlock, factor: float) -> ForeignBlock:
    """Returns the block with image coordinates in another unit."""
    return dataclasses.replace(foreign, rays=foreign.rays._replace(xy=foreign.rays.xy * factor))


def transposed(foreign: ForeignBlock) -> ForeignBlock:
    """Returns the block with transposed rotations."""
    turned = np.swapaxes(foreign.images.rotation, 1, 2)
    return dataclasses.replace(foreign, images=foreign.images._replace(rotation=turned))


def with_rotations(rotation: Float[np.ndarray, "image 3 3"]) -> Callable[[ForeignBlock], ForeignBlock]:
    """A function that changes the rotations of a block."""
    return lambda foreign: dataclasses.replace(foreign, images=foreign.images._replace(rotation=rotation))
