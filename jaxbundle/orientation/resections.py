"""Space resection: the exterior orientation of one image from points that are known (Kraus 2007, ch. 4.2).

The start is given, or it is the best of the solutions with the three points that span the largest angles. The image
equation and the camera models are those of the bundle; the result is that of a bundle whose points are all held.

Many images are adjusted together by vmap.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.float64 import require_float64
from jaxbundle.numerics.host import is_concrete
from jaxbundle.orientation.adjusted_image import Start, adjusted_image
from jaxbundle.orientation.one_image import Measured
from jaxbundle.orientation.six_unknowns import UNKNOWNS
from jaxbundle.solve.adjustment import Status


class Resection(eqx.Module):
    """The orientation of an image; NaN where the iterations did not converge. Angles in radians.

    `cofactors`: of X0, Y0, Z0 and the three angles; times sigma0^2 they are covariances. `residuals`: unit of the rays,
    y up, 0 for points that take no part. Three points leave no redundancy: sigma0 is NaN.
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
        """Whether there is a result."""
        return self.status == int(Status.CONVERGED)

    @property
    def covariance(self) -> Float[Array, "*image 6 6"]:
        """A posteriori, of X0, Y0, Z0 and the three angles."""
        return self.sigma0[..., None, None] ** 2 * self.cofactors

    @property
    def standard_deviations(self) -> Float[Array, "*image 6"]:
        """A posteriori, of X0, Y0, Z0 and the three angles."""
        return self.sigma0[..., None] * jnp.sqrt(jnp.diagonal(self.cofactors, axis1=-2, axis2=-1))

    @property
    def words(self) -> str:
        """How the iterations of one image ended (concrete results only), and what cures it."""
        status = Status(int(self.status))
        cure = {
            Status.CONVERGED: "",
            Status.SINGULAR: "; the points do not determine the image: measure four or more that lie on no one line",
            Status.DIVERGED: " behind the points; give a start on their other side",
        }.get(status, "; give a start, or look for points that are confused")
        return f"the resection {status.words}{cure}"


def resection(
    model: CameraModel,
    interior: Float[ArrayLike, " element"],
    object_points: Float[ArrayLike, "point 3"],
    coordinates: Float[ArrayLike, "point 2"],
    sigmas: Float[ArrayLike, "point 2"] | Float[ArrayLike, ""] = 1.0,
    *,
    start: tuple[Float[ArrayLike, "3"], Float[ArrayLike, "3"]] | None = None,
    system: RotationSystem = OMEGA_PHI_KAPPA,
    max_iterations: int = 50,
) -> Resection:
    """The exterior orientation of an image whose interior is known, by least squares.

    `interior`: elements in the order of the model, as a row of `block.interior.elements`. `coordinates` and their
    `sigmas` in the unit of the rays; an infinite sigma leaves a point out, so that images of different numbers of
    points can be adjusted together by vmap. `start`: projection centre and angles in radians; without one at least four
    points are needed, as three have up to four solutions. jit, vmap and grad go through it.

    Raises: ValueError for what cannot be adjusted, or without float64.
    """
    require_float64()
    _require(model, interior, object_points, coordinates, start)
    sigmas = jnp.broadcast_to(jnp.asarray(sigmas, float), np.shape(coordinates))
    given = jnp.asarray(interior, float), jnp.asarray(object_points, float), jnp.asarray(coordinates, float), sigmas
    place = None if start is None else (jnp.asarray(start[0], float), jnp.asarray(start[1], float))
    if is_concrete((given, place)):
        _require_values(*given, place)
        return _program(model, system, max_iterations, *given, place, optimised=False)
    return _traced(model, system, max_iterations, *given, place)


def _require(model: CameraModel, interior: Any, points: Any, coordinates: Any, start: Any) -> None:
    """What the shapes tell."""
    if np.shape(interior) != (len(model.elements),):
        raise ValueError(f"interior elements of shape {np.shape(interior)}; give {', '.join(model.elements)}")
    count = np.shape(points)[0] if np.ndim(points) else 0
    if np.shape(points) != (count, 3) or np.shape(coordinates) != (count, 2):
        raise ValueError(
            f"object points of shape {np.shape(points)} and image coordinates of shape {np.shape(coordinates)}; give"
            " X, Y, Z and x, y of every point, one row a point"
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
    """What concrete values tell."""
    s = np.asarray(sigmas)
    if not (s > 0).all():
        raise ValueError("a sigma is not positive; give a positive standard deviation, infinite to leave a point out")
    used = np.isfinite(s).all(1)
    _require_count(int(used.sum()), start)
    for what, values in (("point", points), ("image coordinate", coordinates)):
        wrong = np.flatnonzero(used & ~np.isfinite(np.asarray(values)).all(1))
        if len(wrong):
            raise ValueError(
                f"{what} {wrong[0] + 1} is no finite number; give it, or leave it out by an infinite sigma"
            )
    if not all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves((interior, start))):
        raise ValueError("the interior or the start is no finite number; give all of their elements")


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
        """Values of points that take no part may be anything: the mean of the others stands for them."""
        values = jnp.where(used[:, None], values, 0.0)
        return jnp.where(used[:, None], values, values.sum(0) / count)

    points = of_used(points)
    origin = lax.stop_gradient(points.mean(0))  # large coordinates lose digits
    weights = jnp.where(used[:, None], 1 / sigmas, 0.0)
    m = Measured(interior, (points - origin).T, of_used(coordinates).T, weights.T)
    place = None if start is None else Start(_three(start[0] - origin), _three(start[1]))
    a = adjusted_image(model, system, most, m, place)
    centre, angles, cofactors, v = (jnp.array(x) for x in (a.at.centre, a.angles, a.cofactors, a.residuals))
    converged = (a.status == int(Status.CONVERGED)) & (count >= (4 if start is None else 3))
    status = jnp.where(converged | (a.status != int(Status.CONVERGED)), a.status, int(Status.SINGULAR))
    redundancy = 2 * count - UNKNOWNS
    variance = jnp.sum((v.T * weights) ** 2) / jnp.where(redundancy > 0, redundancy, 1)
    sigma0 = jnp.where(redundancy > 0, jnp.sqrt(variance), jnp.nan)
    found = Resection(centre + origin, angles, cofactors, v.T, sigma0, redundancy, status, a.steps)
    return jax.tree.map(
        lambda x: jnp.where(converged, x, jnp.nan) if jnp.isdtype(x.dtype, "real floating") else x, found
    )


_program = Compiled(_resection)
_traced = jax.jit(_resection, static_argnums=(0, 1, 2))


def _three(vector: Float[Array, "3"]) -> tuple[Array, Array, Array]:
    return vector[0], vector[1], vector[2]
