"""The orientation of an image with known interior from points in a plane: both minima.

A homography maps the plane to the rays, d ~ H (u, v, 1); its columns h1, h2, h3 are multiples of the images of the axes
of the plane and of its origin,

    R^T [e1 e2 n] = [h1, h2, h1 x h2] / k,        k = (|h1| + |h2|) / 2,  orthogonalised

A small image of the plane is nearly a parallel projection: the plane reflected at the viewing direction has nearly
the same image (Collins, Bartoli 2014). Least squares start from both.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.orientation.resections import Resection, resection
from jaxbundle.solve.status import Status

IN_A_PLANE = 0.02  # ratio of third and first singular value of the points; above this they are not in a plane
ON_A_LINE = 1e-3  # ratio of second and first singular value
ALIKE = 1.5  # ratio of the misfits: below this both orientations are possible


class PlanarResection(eqx.Module):
    """Two orientations of an image, the better one first.

    Example:
        >>> points, xy = [[0, 0, 0], [10, 0, 0], [10, 8, 0], [0, 8, 0]], [[-12, -10], [13, -9], [9, 8], [-10, 9]]
        >>> found = jb.orientation.planar_resection(jb.cameras.CAMERA_MODELS["none"], [50, 0, 0, 1, 1], points, xy)
        >>> found.better.projection_centre.shape
        (3,)
    """

    better: Resection
    """The orientation with the smaller sum of squares."""
    other: Resection
    """The other minimum; NaN if there is none, or it is the same orientation."""

    @property
    def ratio(self) -> Array:
        """Root of the ratio of the sums of squares of the other and the better orientation."""
        rms = [jnp.sqrt(jnp.sum(found.residuals**2)) for found in (self.better, self.other)]
        return rms[1] / jnp.maximum(rms[0], 1e-300)

    @property
    def words(self) -> str:
        """Problem and cure of the result (concrete results only); empty if there is none."""
        if not bool(self.better.converged):
            return "no orientation fits the points; check their names and coordinates"
        apart = jnp.linalg.norm(self.better.projection_centre - self.other.projection_centre)
        if self.ratio < ALIKE and apart > 0:
            return (
                "two orientations fit the points nearly equally well; add a point off the plane, or choose by the"
                " position of the camera"
            )
        return ""


def planar_resection(
    model: CameraModel,
    interior: Real[ArrayLike, " element"] | Nested,
    object_points: Real[ArrayLike, "point 3"] | Nested,
    coordinates: Real[ArrayLike, "point 2"] | Nested,
    sigmas: Real[ArrayLike, "..."] | Nested = 1.0,
    *,
    system: RotationSystem = OMEGA_PHI_KAPPA,
) -> PlanarResection:
    """Computes the orientation of an image from at least four points in a plane.

    Args:
        model: the camera model, such as CAMERA_MODELS["brown"].
        interior: its elements.
        object_points: X, Y, Z, one row per point.
        coordinates: measured x, y, unit of the rays.
        sigmas: standard deviations of the coordinates.
        system: rotation system of the angles.

    Returns: both minima.

    Raises: ValueError for fewer than four points, points that are not in a plane or on a line, or without float64.

    Example:
        >>> import jaxbundle as jb
        >>> points = [[0, 0, 0], [10, 0, 0], [10, 8, 0], [0, 8, 0]]
        >>> xy = [[-12, -10], [13, -9], [9, 8], [-10, 9]]
        >>> model = jb.cameras.CAMERA_MODELS["none"]
        >>> jb.orientation.planar_resection(model, [50, 0, 0, 1, 1], points, xy).better.projection_centre.shape
        (3,)
    """
    prepare_jax()
    points, xy = np.asarray(object_points, float), np.asarray(coordinates, float)
    if points.ndim != 2 or points.shape[1:] != (3,) or xy.shape != (len(points), 2):
        raise ValueError(
            f"object points of shape {points.shape} and image coordinates of shape {xy.shape}; give X, Y, Z and x, y"
            " of each point"
        )
    if len(points) < 4:
        raise ValueError(f"{len(points)} points of a plane do not determine an image; measure at least 4")
    origin = points.mean(0)
    _, extent, axes = np.linalg.svd(points - origin)
    if extent[1] < ON_A_LINE * extent[0]:
        raise ValueError("the points lie on a line; add a point off this line")
    if extent[2] > IN_A_PLANE * extent[0]:
        raise ValueError("the points do not lie in a plane; use resection")
    frame = axes * np.array([[1.0], [1.0], [np.sign(np.linalg.det(axes))]])  # rows: axes and normal of the plane
    elements = jnp.asarray(interior, float)
    vectors = np.stack([np.asarray(d) for d in direction(model, tuple(elements), tuple(jnp.asarray(xy).T))], 1)
    starts = _starts(points - origin, frame, vectors)
    found = [
        resection(
            model,
            elements,
            points,
            xy,
            jnp.broadcast_to(jnp.asarray(sigmas, float), xy.shape),
            start=(
                jnp.asarray(centre + origin),
                jnp.stack(system.angles_from_rotation(tuple(jnp.asarray(rotation).ravel()))),
            ),
            system=system,
        )
        for rotation, centre in starts
    ]
    squares = [float(jnp.nan_to_num(jnp.sum(one.residuals**2), nan=np.inf)) for one in found]
    better, other = (found[k] for k in np.argsort(squares, kind="stable"))
    same = jnp.linalg.norm(better.projection_centre - other.projection_centre) < 1e-6 * extent[0]
    other = jax.tree.map(lambda x: jnp.where(same, jnp.nan, x) if jnp.isdtype(x.dtype, "real floating") else x, other)
    status = jnp.where(same, int(Status.SINGULAR), other.status)  # there is no second minimum
    other = dataclasses.replace(other, status=status)
    return PlanarResection(better, other)


def _starts(
    points: Float[np.ndarray, "point 3"], frame: Float[np.ndarray, "3 3"], vectors: Float[np.ndarray, "point 3"]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Approximate rotation object_from_image and projection centre of both minima."""
    uv = points @ frame[:2].T
    size = np.abs(uv).max()
    plane = np.c_[uv / size, np.ones(len(uv))]
    a, b = vectors[:, 0] / vectors[:, 2], vectors[:, 1] / vectors[:, 2]
    zero = np.zeros_like(plane)
    rows = np.concatenate([np.c_[plane, zero, -a[:, None] * plane], np.c_[zero, plane, -b[:, None] * plane]])
    h = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    h = h / (0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1])))
    h = -h * np.sign(h[2, 2])  # the origin of the plane is in front: p_z < 0
    first = np.c_[h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])]
    to_origin = size * h[:, 2]  # from the projection centre, in the system of the image
    view = to_origin / np.linalg.norm(to_origin)
    reflected = first[:, :2] - 2 * np.outer(view, view @ first[:, :2])
    second = np.c_[reflected, np.cross(reflected[:, 0], reflected[:, 1])]
    found = []
    for image_from_plane in (first, second):
        u, _, vt = np.linalg.svd(image_from_plane)
        turned = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        rotation = frame.T @ turned.T
        found.append((rotation, -rotation @ to_origin))
    return found
