"""Space resection: the exterior orientation of one image from known points (Kraus 2007, ch. 4.2).

The start is given, or it is the best solution with the three points that span the largest angles. The image equation
and the camera models are those of the bundle; the result is equal to that of a bundle with only fixed points.

Many images are adjusted together by vmap.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Real

from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import is_concrete, on_device, tree_with
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.numerics.shapes import padded
from jaxbundle.orientation.adjusted_image import Start, adjusted_image
from jaxbundle.orientation.one_image import Measured
from jaxbundle.orientation.six_unknowns import UNKNOWNS
from jaxbundle.solve.adjustment import Status


class Resection(eqx.Module):
    """The orientation of an image; NaN if the iterations did not converge. Angles in radians.

    `cofactors`: of X0, Y0, Z0 and the three angles; times sigma0^2 they are covariances. `residuals`: in the unit of
    the rays, y up, 0 for unused points. Without redundancy (three points) sigma0 is NaN.

    Example:
        >>> x = np.array([[0.0, 0, 0], [9, 0, 1], [9, 7, 0], [0, 7, 2], [4, 3, 1]])
        >>> xy = -100 * (x[:, :2] - [4, 3]) / (x[:, 2:] - 20)
        >>> found = jb.orientation.resection(jb.cameras.CAMERA_MODELS["none"], [100, 0, 0, 1, 1], x, xy)
        >>> found.residuals.shape, int(found.redundancy)
        ((5, 2), 4)
    """

    projection_centre: Float[Array, "*image 3"]
    angles: Float[Array, "*image 3"]
    cofactors: Float[Array, "*image 6 6"]
    residuals: Float[Array, "*image point 2"]
    sigma0: Float[Array, "*image"]
    redundancy: Int[Array, "*image"]
    status: Int[Array, "*image"]
    iterations: Int[Array, "*image"]

    @property
    def converged(self) -> Bool[Array, "*image"]:
        """Whether the iterations converged."""
        return self.status == int(Status.CONVERGED)

    @property
    def covariance(self) -> Float[Array, "*image 6 6"]:
        """A-posteriori values of X0, Y0, Z0 and the three angles."""
        return self.sigma0[..., None, None] ** 2 * self.cofactors

    @property
    def standard_deviations(self) -> Float[Array, "*image 6"]:
        """A-posteriori values of X0, Y0, Z0 and the three angles."""
        return self.sigma0[..., None] * jnp.sqrt(jnp.diagonal(self.cofactors, axis1=-2, axis2=-1))

    @property
    def words(self) -> str:
        """Status of the iterations of one image (concrete results only), with a cure."""
        status = Status(int(self.status))
        cure = {
            Status.CONVERGED: "",
            Status.SINGULAR: "; the points do not determine the image: measure four or more that are not on one line",
            Status.DIVERGED: " behind the points; give a start on their other side",
        }.get(status, "; give a start, or check for confused points")
        return f"the resection {status.words}{cure}"


def resection(
    model: CameraModel,
    interior: Real[ArrayLike, " element"] | Nested,
    object_points: Real[ArrayLike, "point 3"] | Nested,
    coordinates: Real[ArrayLike, "point 2"] | Nested,
    sigmas: Real[ArrayLike, "point 2"] | Real[ArrayLike, ""] | Nested = 1.0,
    *,
    start: tuple[Real[ArrayLike, "3"] | Nested, Real[ArrayLike, "3"] | Nested] | None = None,
    system: RotationSystem = OMEGA_PHI_KAPPA,
    max_iterations: int = 50,
) -> Resection:
    """Computes the exterior orientation of an image with known interior by least squares.

    `interior`: elements in the order of the model, as a row of `block.interior.elements`. `coordinates` and their
    `sigmas` in the unit of the rays; an infinite sigma excludes a point, so that images with different numbers of
    points can be batched by vmap. `start`: projection centre and angles in radians; without one at least four
    points are required, as three have up to four solutions. It works with jit, vmap and grad.

    Raises: ValueError for invalid input, or without float64.

    Example:
        >>> x = np.array([[0.0, 0, 0], [9, 0, 1], [9, 7, 0], [0, 7, 2], [4, 3, 1]])
        >>> xy = -100 * (x[:, :2] - [4, 3]) / (x[:, 2:] - 20)
        >>> found = jb.orientation.resection(jb.cameras.CAMERA_MODELS["none"], [100, 0, 0, 1, 1], x, xy)
        >>> np.round(found.projection_centre, 6)
        Array([ 4.,  3., 20.], dtype=float64)
    """
    prepare_jax()
    _require(model, interior, object_points, coordinates, start)
    sigmas = jnp.broadcast_to(jnp.asarray(sigmas, float), np.shape(coordinates))
    given = jnp.asarray(interior, float), jnp.asarray(object_points, float), jnp.asarray(coordinates, float), sigmas
    place = None if start is None else (jnp.asarray(start[0], float), jnp.asarray(start[1], float))
    if is_concrete((given, place)):
        _require_values(*given, place)
        return _concrete(model, system, max_iterations, given, place)
    return _traced(model, system, max_iterations, *given, place)


def _concrete(
    model: CameraModel, system: RotationSystem, most: int, given: tuple[Array, ...], start: tuple[Array, Array] | None
) -> Resection:
    """Padded by excluded points: different numbers of points share a program."""
    interior, *of_points = given
    count = len(of_points[0])
    points, coordinates, sigmas = (padded(np.asarray(x).T).T for x in of_points)
    sigmas = np.where(np.arange(len(sigmas))[:, None] < count, sigmas, np.inf)
    found = _program(model, system, most, interior, *on_device((points, coordinates, sigmas)), start, optimised=False)
    return tree_with(lambda r: r.residuals, found, np.asarray(found.residuals)[:count])


def _require(model: CameraModel, interior: Any, points: Any, coordinates: Any, start: Any) -> None:
    """Raises ValueError for invalid shapes."""
    if np.shape(interior) != (len(model.elements),):
        raise ValueError(f"interior elements of shape {np.shape(interior)}; give {', '.join(model.elements)}")
    count = np.shape(points)[0] if np.ndim(points) else 0
    if np.shape(points) != (count, 3) or np.shape(coordinates) != (count, 2):
        raise ValueError(
            f"object points of shape {np.shape(points)} and image coordinates of shape {np.shape(coordinates)}; give"
            " X, Y, Z and x, y of each point, one row per point"
        )
    _require_count(count, start)
    if start is not None and [np.shape(part) for part in start] != [(3,), (3,)]:
        raise ValueError("a start is a pair: projection centre (3 coordinates) and angles (3, in radians)")


def _require_count(count: int, start: Any) -> None:
    if count < 3:
        raise ValueError(f"{count} points do not determine an image; measure at least 3 points on it, better 6")
    if count < 4 and start is None:
        raise ValueError("3 points have up to four solutions; measure a fourth point, or give a start")


def _require_values(interior: Array, points: Array, coordinates: Array, sigmas: Array, start: Any) -> None:
    """Raises ValueError for invalid concrete values."""
    s = np.asarray(sigmas)
    if not (s > 0).all():
        raise ValueError("a sigma is not positive; give a positive standard deviation, infinite to exclude a point")
    used = np.isfinite(s).all(1)
    _require_count(int(used.sum()), start)
    for what, values in (("point", points), ("image coordinate", coordinates)):
        wrong = np.flatnonzero(used & ~np.isfinite(np.asarray(values)).all(1))
        if len(wrong):
            raise ValueError(
                f"{what} {wrong[0] + 1} is not a finite number; give it, or exclude it with an infinite sigma"
            )
    if not all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves((interior, start))):
        raise ValueError(
            "the interior or the start has a value that is not a finite number; give all of their elements"
        )


def _resection(
    model: CameraModel,
    system: RotationSystem,
    most: int,
    interior: Array,
    points: Array,
    coordinates: Array,
    sigmas: Array,
    start: tuple[Array, Array] | None,
) -> Resection:
    used = jnp.isfinite(sigmas).all(1)
    count = used.sum()

    def of_used(values: Array) -> Array:
        """Replaces the values of unused points, which may be arbitrary, by the mean of the others."""
        values = jnp.where(used[:, None], values, 0.0)
        return jnp.where(used[:, None], values, values.sum(0, keepdims=True) / count.astype(float))

    points = of_used(points)
    origin = lax.stop_gradient(points.mean(0))  # large coordinates lose digits
    weights = jnp.where(used[:, None], 1 / sigmas, 0.0)
    m = Measured(interior, (points - origin[None]).T, of_used(coordinates).T, weights.T)
    place = None if start is None else Start(_three(start[0] - origin), _three(start[1]))
    a = adjusted_image(model, system, most, m, place)
    centre, angles, cofactors, v = (jnp.array(x) for x in (a.at.centre, a.angles, a.cofactors, a.residuals))
    converged = (a.status == int(Status.CONVERGED)) & (count >= (4 if start is None else 3))
    status = jnp.where(converged | (a.status != int(Status.CONVERGED)), a.status, int(Status.SINGULAR))
    redundancy = 2 * count - UNKNOWNS
    variance = jnp.sum((v.T * weights) ** 2) / jnp.where(redundancy > 0, redundancy, 1).astype(float)
    sigma0 = jnp.where(redundancy > 0, jnp.sqrt(variance), jnp.nan)
    found = Resection(centre + origin, angles, cofactors, v.T, sigma0, redundancy, status, a.steps)
    return jax.tree.map(
        lambda x: jnp.where(converged, x, jnp.nan) if jnp.isdtype(x.dtype, "real floating") else x, found
    )


_program = Compiled(_resection)
_traced = jax.jit(_resection, static_argnums=(0, 1, 2))


def _three(vector: Float[Array, "3"]) -> tuple[Array, Array, Array]:
    return vector[0], vector[1], vector[2]
