"""Misfit of the rays of a file at its own orientations; it detects a wrong axis, a transposed matrix or a wrong unit.

    v = computed - observed at the values of the file, without adjustment

Tie rays are compared with the points of the file, or with their intersection where the file has none; rays of
control points with the known coordinates. The criterion is the root mean square of |v|. Each |v| is limited to the
width of its image, and a point behind the camera counts as this width. So a single gross error does not decide, and an
interpretation with all points behind the cameras is the worst.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.vectors import Vector
from jaxbundle.io.formats.foreign_block import ForeignBlock, element

EXTENT = 95.0  # percentile of the rays that estimates the size of an image that is not given


class Misfit(NamedTuple):
    """Misfit of some rays, in the unit of the rays.

    `rays`: their number; root mean square per coordinate and largest residual; `share`: the criterion, as a share of
    the image width; `behind`: number of points behind cameras.
    """

    rays: int
    rms: float
    largest: float
    share: float
    behind: int


NONE = Misfit(0, np.nan, np.nan, np.nan, 0)


class Misfits(NamedTuple):
    """Misfits of the tie rays, and of the rays of control points."""

    tie: Misfit
    control: Misfit


def ray_residuals(
    foreign: ForeignBlock, points: Float[np.ndarray, "point 3"] | None = None
) -> tuple[Float[np.ndarray, "ray 2"], Bool[np.ndarray, " ray"]]:
    """Residuals of all rays in the unit of the rays, NaN where image or point is unknown, and which points lie behind.

    `points`: coordinates to use instead of those of the file.
    """
    rays, images = foreign.rays, foreign.images
    points = foreign.points.coordinates if points is None else points
    v, behind = np.full((len(rays.image), 2), np.nan), np.zeros(len(rays.image), bool)
    camera = images.camera[rays.image] if len(rays.image) else np.zeros(0, np.int64)
    origin = origin_of(foreign)
    with np.errstate(all="ignore"):
        for model, own in cameras_by_model(foreign).items():
            some = np.flatnonzero(np.isin(camera, own))
            vector = photo_vectors(foreign, some, points, origin)
            values = interior_of(foreign, model, camera[some])
            residual = model.residual(tuple(values), vector, tuple(rays.xy[some].T))
            v[some] = np.stack(np.broadcast_arrays(*residual), -1)
            behind[some] = np.asarray(vector[2] >= 0)
    return v, behind


def origin_of(foreign: ForeignBlock) -> Float[np.ndarray, "3"]:
    """The mean of the known projection centres, to reduce coordinates: large coordinates lose digits."""
    known = foreign.images.centre[np.isfinite(foreign.images.centre).all(1)]
    return known.mean(0) if len(known) else np.zeros(3)


def photo_vectors(
    foreign: ForeignBlock, rays: Int[np.ndarray, " ray"], points: Float[np.ndarray, "point 3"], origin: np.ndarray
) -> Vector:
    """Photo vectors p = R^T (X - X0) of some rays."""
    images, image, point = foreign.images, foreign.rays.image[rays], foreign.rays.point[rays]
    rotation = images.rotation[image].reshape(-1, 9).T
    return photo_vector(tuple(rotation), tuple((images.centre[image] - origin).T), tuple((points[point] - origin).T))


def interior_of(
    foreign: ForeignBlock, model: CameraModel, cameras: Int[np.ndarray, " ray"]
) -> Float[np.ndarray, "element ray"]:
    """Interior elements of the camera of each ray, for one model."""
    table = np.array([[element(camera, name) for name in model.elements] for camera in foreign.cameras], float)
    return table[cameras].T


def cameras_by_model(foreign: ForeignBlock) -> dict[CameraModel, Int[np.ndarray, " _camera"]]:
    """Numbers of the cameras with each model."""
    models = dict.fromkeys(camera.model for camera in foreign.cameras)
    return {m: np.array([k for k, camera in enumerate(foreign.cameras) if camera.model is m]) for m in models}


def widths(foreign: ForeignBlock) -> Float[np.ndarray, " camera"]:
    """Longer side of the images of each camera, in the unit of its rays; estimated from the rays if not given."""
    found = np.ones(len(foreign.cameras))
    camera = foreign.images.camera[foreign.rays.image] if len(foreign.rays.image) else np.zeros(0, np.int64)
    for k, one in enumerate(foreign.cameras):
        own = foreign.rays.xy[camera == k]
        if one.image_unit == "px" and one.width and one.height:
            found[k] = max(one.width, one.height)
        elif len(own):
            found[k] = max(2 * np.percentile(np.abs(own - np.median(own, 0)), EXTENT), 1e-9)
    return found


def is_control(foreign: ForeignBlock) -> Bool[np.ndarray, " point"]:
    """Mask of the points that are control points or check points."""
    names = {row.name for row in foreign.control}
    return np.array([name in names for name in foreign.points.names], bool)


def misfits(foreign: ForeignBlock) -> Misfits:
    """Misfits of the rays for this interpretation of a file."""
    control = is_control(foreign)
    known = np.full(foreign.points.coordinates.shape, np.nan)
    position = {name: k for k, name in enumerate(foreign.points.names)}
    for row in foreign.control:
        if row.name in position:
            known[position[row.name]] = row.coordinates
    of_control = control[foreign.rays.point] if len(foreign.rays.point) else np.zeros(0, bool)
    tie = _misfit(foreign, foreign.points.coordinates, ~of_control)
    return Misfits(tie, NONE if foreign.arbitrary else _misfit(foreign, known, of_control))


def _misfit(foreign: ForeignBlock, points: Float[np.ndarray, "point 3"], wanted: Bool[np.ndarray, " ray"]) -> Misfit:
    if not wanted.any():
        return NONE
    rays, images = foreign.rays, foreign.images
    known = wanted & images.oriented[rays.image] & np.asarray(np.isfinite(points).all(1))[rays.point]
    if not known.any():
        return NONE
    v, behind = ray_residuals(foreign, points)
    width = widths(foreign)[images.camera[rays.image[known]]]
    with np.errstate(all="ignore"):
        size = np.hypot(*v[known].T)
        judged = np.where(np.isfinite(size) & ~behind[known], np.minimum(size, width), width) / width
        usable = size[np.isfinite(size)]
        rms = float(np.sqrt(np.sum(usable**2) / max(2 * len(usable), 1)))
    largest = float(usable.max()) if len(usable) else np.inf
    return Misfit(int(known.sum()), rms, largest, float(np.sqrt(np.mean(judged**2))), int(behind[known].sum()))
