"""Intersecting points without coordinates: closest point to the rays, then least squares in the image.

Gauss-Newton steps take the derivatives of the projection without distortion, which converge to the same minimum.
"""

import dataclasses
from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.io.formats.foreign_block import ForeignBlock
from jaxbundle.io.formats.misfit import cameras_by_model, interior_of, origin_of, photo_vectors, ray_residuals
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.orientation.intersection import closest_to_rays

STEPS = 4  # steps of Gauss-Newton: the second one is below the precision of image coordinates
FLAT = 1e-12  # of the scaled determinant of the normal equations: below this the rays are parallel


def with_intersections(foreign: ForeignBlock) -> ForeignBlock:
    """The block in which missing coordinates are intersected from the rays of two or more images."""
    points = foreign.points.coordinates
    missing = np.asarray(np.isnan(points).any(1))
    rays, images = foreign.rays, foreign.images
    if not missing.any() or not len(rays.image):
        return foreign
    oriented = images.oriented
    some = np.flatnonzero(missing[rays.point] & oriented[rays.image])
    if not len(some):
        return foreign
    origin = origin_of(foreign)
    with np.errstate(all="ignore"):
        along = _directions(foreign, some)
        turned = np.einsum("nij,jn->in", images.rotation[rays.image[some]], along)
        centres = (images.centre[rays.image[some]] - origin).T
        closest = np.asarray(closest_to_rays(turned, centres, rays.point[some], len(points))).T + origin
        several = np.bincount(rays.point[some], minlength=len(points)) >= 2
        found = np.where((missing & several)[:, None], closest, points)
        for _ in range(STEPS):
            found = _improved(foreign, found, some, missing)
    return dataclasses.replace(foreign, points=foreign.points._replace(coordinates=found))


@cache
def _program(model: CameraModel) -> Callable:
    return jax.jit(lambda interior, xy: jnp.stack(direction(model, tuple(interior), (xy[0], xy[1]))))


def _directions(foreign: ForeignBlock, some: np.ndarray) -> Float[np.ndarray, "3 ray"]:
    """Unit vectors along rays in the system of the photograph."""
    camera = foreign.images.camera[foreign.rays.image[some]]
    along = np.full((3, len(some)), np.nan)
    for model, own in cameras_by_model(foreign).items():
        at = np.flatnonzero(np.isin(camera, own))
        if len(at):
            padded = np.resize(at, grid_size(len(at), 64, 1.5))
            values = interior_of(foreign, model, camera[padded])
            along[:, at] = np.asarray(_program(model)(values, foreign.rays.xy[some[padded]].T))[:, : len(at)]
    return along


def _improved(
    foreign: ForeignBlock, points: Float[np.ndarray, "point 3"], some: np.ndarray, missing: Bool[np.ndarray, " point"]
) -> Float[np.ndarray, "point 3"]:
    """A Gauss-Newton step of each missing point; points that a step would make worse are unchanged."""
    rays, images = foreign.rays, foreign.images
    v, _ = ray_residuals(foreign, points)
    px, py, pz = photo_vectors(foreign, some, points, origin_of(foreign))
    c = np.array([_scale(foreign, k) for k in range(len(foreign.cameras))])[images.camera[rays.image[some]]]
    zero = np.zeros_like(px)
    rows = np.stack([np.stack([-c / pz, zero, c * px / pz**2], -1), np.stack([zero, -c / pz, c * py / pz**2], -1)], 1)
    rows = rows @ np.swapaxes(images.rotation[rays.image[some]], 1, 2)
    point = rays.point[some]
    normals, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normals, point, np.swapaxes(rows, 1, 2) @ rows)
    np.add.at(right, point, -np.einsum("nki,nk->ni", rows, v[some]))
    size = np.trace(normals, axis1=1, axis2=2)
    usable = missing & (np.linalg.det(normals) > FLAT * size**3) & np.isfinite(right).all(1)
    step = np.zeros_like(points)
    step[usable] = np.linalg.solve(normals[usable], right[usable][..., None])[..., 0]
    return points + step


def _scale(foreign: ForeignBlock, camera: int) -> float:
    """Principal distance in the unit of the rays."""
    elements = foreign.cameras[camera].elements
    return float(elements.get("principal_distance", 1.0)) / float(elements.get("pixel_size", 1.0))
