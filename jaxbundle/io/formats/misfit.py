"""How well the rays of a file fit its own orientations: what tells a wrong axis, a transposed matrix or a wrong unit.

    v = computed - observed at the file's own values, no adjustment

A reading is judged by the root mean square of |v|, of which no ray counts more than the width of its image; a point
behind the camera counts as much. So one wild ray decides nothing, and a reading that puts all points behind is the worst.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.io.formats.foreign_block import ForeignBlock, element

EXTENT = 95.0  # percent of the rays that tell the size of an image that is not given


class Misfit(NamedTuple):
    """Rays that were tried, their root mean square per coordinate and largest residual, in the unit of the rays;
    `share`: the root mean square judged, as a share of the image width; points behind cameras."""

    rays: int
    rms: float
    largest: float
    share: float
    behind: int


def ray_residuals(
    foreign: ForeignBlock, points: Float[np.ndarray, "point 3"] | None = None
) -> tuple[Float[np.ndarray, "ray 2"], Bool[np.ndarray, " ray"]]:
    """Residuals of all rays in the unit of the rays, NaN where image or point is not known; and what lies behind.

    `points`: other coordinates of the points.
    """
    rays, images = foreign.rays, foreign.images
    points = foreign.points.coordinates if points is None else points
    v, behind = np.full((len(rays.image), 2), np.nan), np.zeros(len(rays.image), bool)
    camera = images.camera[rays.image] if len(rays.image) else np.zeros(0, np.int64)
    origin = np.nan_to_num(images.centre).mean(0) if len(images.centre) else np.zeros(3)
    with np.errstate(all="ignore"):
        for model, own in _cameras_by_model(foreign).items():
            some = np.flatnonzero(np.isin(camera, own))
            values = np.array([[element(foreign.cameras[k], name) for name in model.elements] for k in own])
            row = np.searchsorted(own, camera[some])
            rotation = images.rotation[rays.image[some]].reshape(-1, 9).T
            centre, point = images.centre[rays.image[some]] - origin, points[rays.point[some]] - origin
            vector = photo_vector(tuple(rotation), tuple(centre.T), tuple(point.T))
            residual = model.residual(tuple(values[row].T), vector, tuple(rays.xy[some].T))
            v[some] = np.stack(np.broadcast_arrays(*residual), -1)
            behind[some] = np.asarray(vector[2] >= 0)
    return v, behind


def _cameras_by_model(foreign: ForeignBlock) -> dict[CameraModel, Int[np.ndarray, " camera"]]:
    models = dict.fromkeys(camera.model for camera in foreign.cameras)
    return {m: np.array([k for k, camera in enumerate(foreign.cameras) if camera.model is m]) for m in models}


def widths(foreign: ForeignBlock) -> Float[np.ndarray, " camera"]:
    """Widths of the images of each camera in the unit of its rays; of a format that is not given, that of the rays."""
    found = np.ones(len(foreign.cameras))
    camera = foreign.images.camera[foreign.rays.image] if len(foreign.rays.image) else np.zeros(0, np.int64)
    for k, one in enumerate(foreign.cameras):
        own = foreign.rays.xy[camera == k]
        if one.image_unit == "px" and one.width and one.height:
            found[k] = max(one.width, one.height)
        elif len(own):
            found[k] = max(2 * np.percentile(np.abs(own - np.median(own, 0)), EXTENT), 1e-9)
    return found


def misfit(foreign: ForeignBlock) -> Misfit:
    """What the rays say of this reading of a file."""
    v, behind = ray_residuals(foreign)
    rays, images, points = foreign.rays, foreign.images, foreign.points.coordinates
    known = np.isfinite(images.rotation).all((1, 2))[rays.image] & np.isfinite(images.centre).all(1)[rays.image]
    known &= np.isfinite(points).all(1)[rays.point]
    if not known.any():
        return Misfit(0, np.nan, np.nan, np.nan, 0)
    width = widths(foreign)[images.camera[rays.image[known]]]
    with np.errstate(all="ignore"):
        size = np.hypot(*v[known].T)
        judged = np.where(np.isfinite(size) & ~behind[known], np.minimum(size, width), width) / width
        usable = size[np.isfinite(size)]
        rms = float(np.sqrt(np.sum(usable**2) / max(2 * len(usable), 1)))
    largest = float(usable.max()) if len(usable) else np.inf
    return Misfit(int(known.sum()), rms, largest, float(np.sqrt(np.mean(judged**2))), int(behind[known].sum()))
