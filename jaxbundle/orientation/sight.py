"""The rays of a block as directions, and their angles to the points at given orientations.

A measured point is the photo vector (a, b, -1) of its camera model, with the given interior elements. The misfit of a
ray is the angle between this vector and the photo vector p = R^T (X - X0) of the object point: 0 if they agree, above
90 degrees if the point is behind the camera.

The module uses only numpy: approximate values are checked before anything is compiled for the adjustment.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.orientation.intersection import closest_to_rays

MIN_FIELD = 1e-6  # rad; an image whose rays have one direction has no image field
HALF = np.pi / 2


class Sight(NamedTuple):
    """Rays as directions, and the approximate values for the comparison.

    `plane`: a and b of the photo vectors (a, b, -1). `rotation`: object_from_image. `known`: coordinates of control
    points, observed or fixed, NaN if there are none. `field`: image field, for each image the median angle between
    the rays of its camera and their mean, in radians.
    """

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    plane: Float[np.ndarray, "ray 2"]
    rotation: Float[np.ndarray, "image 3 3"]
    centre: Float[np.ndarray, "image 3"]
    points: Float[np.ndarray, "point 3"]
    known: Float[np.ndarray, "point 3"]
    field: Float[np.ndarray, " image"]

    @property
    def is_known(self) -> Bool[np.ndarray, " point"]:
        """Mask of the points with three observed or fixed coordinates."""
        return np.asarray(np.isfinite(self.known).all(1))

    @property
    def is_believed(self) -> Bool[np.ndarray, " point"]:
        """Mask of the points with three known or approximate coordinates."""
        return np.asarray(np.isfinite(self.believed).all(1))

    @property
    def believed(self) -> Float[np.ndarray, "point 3"]:
        """Control coordinates if known, otherwise the approximate ones."""
        return np.where(np.isfinite(self.known), self.known, self.points)


def sight_of(block: Block) -> Sight:
    """The rays of a block whose values are concrete."""
    structure, unknowns = block.structure, unknowns_of(block)
    plane = _plane(block, np.asarray(block.rays.coordinates))
    camera = structure.image_camera[structure.ray_image]
    rotation = np.asarray(unknowns.rotation).T.reshape(-1, 3, 3)
    centre, points = np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)
    field = _fields(plane, camera, structure.image_camera)
    return Sight(structure.ray_image, structure.ray_point, plane, rotation, centre, points, _known(block), field)


def _plane(block: Block, measured: Float[np.ndarray, "ray 2"]) -> Float[np.ndarray, "ray 2"]:
    """Components a and b of the photo vectors of the measured points."""
    structure, rays = block.structure, len(measured)
    size = grid_size(rays)
    coordinates, camera = np.zeros((2, size)), np.zeros(size, np.int32)
    coordinates[:, :rays] = measured.T
    camera[:rays] = structure.image_camera[structure.ray_image]
    if rays:  # padded with rays of the block: for other points the correction of a distortion might not converge
        coordinates[:, rays:], camera[rays:] = coordinates[:, :1], camera[0]
    interior = unknowns_of(block).interior
    plane = _planes(structure.model, interior, on_device(camera), on_device(coordinates), optimised=False)
    return np.asarray(plane)[:, :rays].T


def direction_sigmas(block: Block, sight: Sight) -> Float[np.ndarray, " ray"]:
    """Standard deviations of the directions of the rays in radians, from those of the image coordinates."""
    sigmas = np.asarray(block.rays.sigmas).mean(1)
    beside = _plane(block, np.asarray(block.rays.coordinates) + sigmas[:, None] * [1.0, 0.0])
    return angle_off(sight.plane, np.c_[beside, -np.ones(len(beside))])


@Compiled
def _planes(
    model: CameraModel,
    interior: Float[Array, "element camera"],
    camera: Int[Array, " ray"],
    coordinates: Float[Array, "2 ray"],
) -> Float[Array, "2 ray"]:
    x, y, z = direction(model, tuple(interior[:, camera]), (coordinates[0], coordinates[1]))
    return jnp.stack([-x / z, -y / z])


def _known(block: Block) -> Float[np.ndarray, "point 3"]:
    """Fixed or observed coordinates."""
    known = np.where(block.structure.point_free, np.nan, np.asarray(block.object_points))
    for group in block.groups:
        if group.structure.kind == CONTROL:
            point, observed = group.structure.indices[:, 0], group.structure.observed
            known[point] = np.where(observed, np.asarray(group.values), known[point])
    return known


def _fields(
    plane: Float[np.ndarray, "ray 2"], camera: Int[np.ndarray, " ray"], image_camera: Int[np.ndarray, " image"]
) -> Float[np.ndarray, " image"]:
    field = np.full(int(image_camera.max(initial=-1)) + 1, np.nan)
    order = np.argsort(camera, kind="stable")
    bounds = np.flatnonzero(np.diff(camera[order])) + 1
    for rays in np.split(order, bounds) if len(order) else ():
        # the centre of an image is near the axis: for few rays the axis is the better mean
        field[camera[rays[0]]] = np.median(np.arctan(np.hypot(*plane[rays].T)))
    return np.maximum(np.nan_to_num(field, nan=1.0), MIN_FIELD)[image_camera]


def photo_vectors(sight: Sight, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "ray 3"]:
    """Photo vectors p = R^T (X - X0) of all rays."""
    return np.einsum("rij,ri->rj", sight.rotation[sight.image], points[sight.point] - sight.centre[sight.image])


def off(sight: Sight, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " ray"]:
    """Angles between the rays and their points, in radians; NaN if a point is at a projection centre."""
    return angle_off(sight.plane, photo_vectors(sight, points))


def angle_off(plane: Float[np.ndarray, "... 2"], vector: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
    """Angles between measured and computed photo vectors."""
    (a, b), (x, y, z) = np.moveaxis(plane, -1, 0), np.moveaxis(vector, -1, 0)
    across = np.sqrt((b * z + y) ** 2 + (x + a * z) ** 2 + (a * y - b * x) ** 2)
    along = a * x + b * y - z
    angle = np.arctan2(across, along)
    angle[(across == 0) & (along == 0)] = np.nan
    return angle


def relative_off(sight: Sight, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " ray"]:
    """Angles between rays and points in image fields: 1 is half of the image; infinite if undefined."""
    return np.nan_to_num(off(sight, points) / sight.field[sight.image], nan=np.inf)


class Intersected(NamedTuple):
    """Points only from their rays; NaN for parallel rays or fewer than two. `in_front`: in front of all cameras."""

    points: Float[np.ndarray, "point 3"]
    in_front: Bool[np.ndarray, " point"]


def intersected(sight: Sight, images: Bool[np.ndarray, " image"] | None = None) -> Intersected:
    """Intersects all points from their rays on chosen images."""
    used = np.ones(len(sight.image), bool) if images is None else images[sight.image]
    image, point = sight.image[used], sight.point[used]
    along = np.c_[sight.plane[used], -np.ones(len(image))]
    along = np.einsum("rij,rj->ir", sight.rotation[image], along)
    along = along / np.sqrt((along**2).sum(0))
    centres = sight.centre[image].T
    count = np.bincount(point, minlength=len(sight.points))
    if not len(image):
        return Intersected(np.full(sight.points.shape, np.nan), np.zeros(len(count), bool))
    points = np.array(closest_to_rays(along, centres, point, len(count)).T)
    points[count < 2] = np.nan
    depth = ((points[point] - centres.T) * along.T).sum(1)
    behind = np.bincount(point, ~(depth > 0), len(count)) > 0
    return Intersected(points, (count >= 2) & ~behind)


def mostly_beyond(
    values: Float[np.ndarray, " ray"],
    limits: Float[np.ndarray, " entity"] | float,
    of: Int[np.ndarray, " ray"],
    count: int,
) -> Bool[np.ndarray, " entity"]:
    """Mask of images or points whose (lower) median over the rays exceeds a limit, without sorting."""
    beyond = ~(values <= (limits[of] if isinstance(limits, np.ndarray) else limits))
    return 2 * np.bincount(of, beyond, count) > np.bincount(of, minlength=count)


def only(sight: Sight, rays: Bool[np.ndarray, " ray"]) -> Sight:
    """The selection of some rays."""
    return sight._replace(image=sight.image[rays], point=sight.point[rays], plane=sight.plane[rays])


def medians(values: Float[np.ndarray, " ray"], of: Int[np.ndarray, " ray"], count: int) -> Float[np.ndarray, " entity"]:
    """Median (the lower one of two) over the rays of each image or point; NaN without rays."""
    order = np.lexsort((values, of))
    number = np.bincount(of, minlength=count)
    first = np.cumsum(number) - number
    result = np.full(count, np.nan)
    some = number > 0
    result[some] = values[order][(first + (number - 1) // 2)[some]]
    return result
