"""Relative orientation of two photographs without approximate values: five elements, y-parallaxes, model points.

    dependent      the first photograph fixes the system: two components of the base, omega, phi, kappa of the second
    independent    the base is the X axis: phi, kappa of the first, omega, phi, kappa of the second photograph

The third component of the base (dependent) or its length (independent) is the given scale of the model.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import from_omega_phi_kappa, to_omega_phi_kappa
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import is_concrete
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.orientation import coplanarity
from jaxbundle.orientation.coplanarity import REJECTED, Pair, Rays
from jaxbundle.orientation.pair_search import PARALLEL, Found, angular_variance, search, sides

Convention = Literal["dependent", "independent"]
SELECTIONS, SELECTION_STEPS, FINAL_STEPS = 3, 5, 20
SETTLED = 1e-7  # rad: limit of the last step; the next one would be of the order of its square
ALIKE = 1.2  # ratio of the costs of two orientations that cannot be distinguished
EXACT = 1e-12  # cost of an orientation that fits exactly: parallaxes of some millionths of their sigmas are rounding
MIN_SHARE = 0.25  # minimum share of the points in addition to five: fewer may fit by chance
UNDETERMINED = 1e-12  # ratio of minimum and maximum eigenvalue of the normal equations with a unit diagonal


class RelativeOrientation(eqx.Module):
    """Result of `relative_orientation`. Angles in radians; the unit of lengths is that of the base.

    Example:
        >>> x = np.array([[0, 0, -5], [1, 0, -6], [0, 1, -5], [1, 1, -6], [0, -1, -4], [1, -1, -5]])
        >>> image = lambda x: -100 * x[:, :2] / x[:, 2:]
        >>> camera = jb.cameras.CAMERA_MODELS["none"], [100, 0, 0, 1, 1]
        >>> found = jb.orientation.relative_orientation(*camera, image(x), image(x - [1, 0, 0]))
        >>> bool(abs(found.elements).max() < 1e-6)
        True
    """

    convention: str = eqx.field(static=True)
    """`dependent` or `independent`."""
    elements: Float[Array, "*pair 5"]
    """The five elements, see `names`."""
    cofactors: Float[Array, "*pair 5 5"]
    """Cofactors of the elements; times sigma0^2 they are covariances."""
    rotations: Float[Array, "*pair 2 3 3"]
    """Matrices model_from_image of both photographs."""
    projection_centres: Float[Array, "*pair 2 3"]
    """Projection centres in the model; the first one is the origin."""
    model_points: Float[Array, "*pair point 3"]
    """Model points: intersections of the corrected rays."""
    model_cofactors: Float[Array, "*pair point 3 3"]
    """Cofactors of the model points, from the image coordinates and the elements."""
    parallaxes: Float[Array, "*pair point"]
    """y-parallaxes, unit of the image coordinates: in the normal case the difference of y."""
    parallaxes_before: Float[Array, "*pair point"]
    """y-parallaxes with the approximate orientation at the start of the least squares."""
    used: Bool[Array, "*pair point"]
    """Mask of the points used in the least squares; the others were rejected or have an infinite sigma."""
    in_front: Bool[Array, "*pair point"]
    """Mask of the points in front of both photographs."""
    sigma0: Float[Array, "*pair"]
    """A-posteriori standard deviation of unit weight; NaN without redundancy."""
    redundancy: Array
    """Number of used points minus 5."""
    converged: Bool[Array, "*pair"]
    """Whether the last step was negligible and the five elements are determined."""
    parallel: Bool[Array, "*pair"]
    """Whether both rays of most points are parallel within their errors: there is no base."""
    other_rotation: Float[Array, "*pair 3 3"]
    """Rotation model_from_image of the second photograph in the next best orientation, system of the first one."""
    other_base: Float[Array, "*pair 3"]
    """Base of the next best orientation, a unit vector."""
    costs: Float[Array, "*pair 2"]
    """Costs of the best and of the next best start: misfits and points behind a photograph."""
    fixed: Array
    """Component of the base that is fixed in the dependent case: 0, 1 or 2."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the elements of one pair (concrete results only)."""
        if self.convention == "independent":
            return "phi1", "kappa1", "omega2", "phi2", "kappa2"
        base = [name for k, name in enumerate(("bx", "by", "bz")) if k != int(self.fixed)]
        return (*base, "omega2", "phi2", "kappa2")

    @property
    def standard_deviations(self) -> Float[Array, "*pair 5"]:
        """A-posteriori standard deviations of the elements."""
        return self.sigma0[..., None] * jnp.sqrt(jnp.diagonal(self.cofactors, axis1=-2, axis2=-1))

    @property
    def ambiguous(self) -> Bool[Array, "*pair"]:
        """Whether another orientation has a similar cost; without redundancy, whether it fits exactly too."""
        variance = jnp.where(jnp.isnan(self.sigma0), 0.0, jnp.minimum(self.sigma0**2, 1.0))
        return self.costs[..., 1] <= ALIKE * self.costs[..., 0] + jnp.maximum(variance, EXACT)

    @property
    def words(self) -> str:
        """Problem and cure of the orientation of one pair (concrete results only); empty if there is none."""
        used, valid = int(self.used.sum()), int(np.isfinite(self.parallaxes).sum())
        if self.parallel:
            return "the rays are parallel after a rotation, there is no base; use two images from different stations"
        if used < 5 + MIN_SHARE * (valid - 5):
            return f"only {used} of {valid} points fit one orientation; check for confused points"
        behind = int((self.used & ~self.in_front).sum())
        if behind > used // 10:
            return f"{behind} of {used} points lie behind a photograph; check for confused points or images"
        if self.ambiguous:
            return "another orientation fits the points as well; measure more points, some of them off the common plane"
        return (
            "" if self.converged else "the points do not determine the orientation; measure points at other positions"
        )


def relative_orientation(
    model: CameraModel,
    interior: Real[ArrayLike, " element"] | Nested,
    first: Real[ArrayLike, "point 2"] | Nested,
    second: Real[ArrayLike, "point 2"] | Nested,
    sigmas: Real[ArrayLike, "..."] | Nested = 1.0,
    *,
    second_camera: tuple[CameraModel, Real[ArrayLike, " element_of_second"] | Nested] | None = None,
    convention: Convention = "dependent",
    base: float = 1.0,
    robust: bool = True,
    samples: int = 256,
    seed: int = 0,
) -> RelativeOrientation:
    """Computes the relative orientation of two images of the same points, without approximate values.

    Args:
        model: camera model.
        interior: its elements, as a row of `block.interior.elements`.
        first: image coordinates of the points in the first image, one row per point.
        second: in the second image.
        sigmas: standard deviations of all image coordinates, one number or (point, 2); infinite excludes a point, so
            that pairs with different numbers of points can be batched by vmap.
        second_camera: model and interior elements of the second image, if different.
        convention: "dependent" or "independent".
        base: size of the maximum component of the base (dependent) or its length (independent).
        robust: whether points whose y-parallax exceeds three standard deviations are rejected.
        samples: number of samples of five points. 256 are sufficient for 51 % wrong points in 999 of 1000 cases.
        seed: seed of the samples.

    Returns: the orientation with its precision, and the next best one. It works with jit and vmap.

    Raises: ValueError for invalid input, or without float64.

    Example:
        >>> import numpy as np, jaxbundle as jb
        >>> x = np.array([[0, 0, -5], [1, 0, -6], [0, 1, -5], [1, 1, -6], [0, -1, -4], [1, -1, -5]])
        >>> image = lambda x: -100 * x[:, :2] / x[:, 2:]
        >>> camera = jb.cameras.CAMERA_MODELS["none"], [100, 0, 0, 1, 1]
        >>> found = jb.orientation.relative_orientation(*camera, image(x), image(x - [1, 0, 0]))
        >>> found.names
        ('by', 'bz', 'omega2', 'phi2', 'kappa2')
    """
    prepare_jax()
    if convention not in ("dependent", "independent"):
        raise ValueError(f'the convention is "dependent" or "independent", not {convention!r}')
    cameras = (model, interior), second_camera or (model, interior)
    for camera, elements in cameras:
        if np.shape(elements) != (len(camera.elements),):
            raise ValueError(f"interior elements of shape {np.shape(elements)}; give {', '.join(camera.elements)}")
    count = np.shape(first)[0] if np.ndim(first) else 0
    if np.shape(first) != (count, 2) or np.shape(second) != (count, 2):
        raise ValueError(
            f"image coordinates of shapes {np.shape(first)} and {np.shape(second)}; give x, y of each point in both"
        )
    xy, xy2 = jnp.asarray(first, float), jnp.asarray(second, float)
    s = jnp.broadcast_to(jnp.asarray(sigmas, float), (count, 2))
    used = int(np.isfinite(np.asarray(s)).all(1).sum()) if is_concrete(s) else count
    if used < 5:
        raise ValueError(f"{used} common points do not determine a relative orientation; measure at least 5, better 15")
    if is_concrete((xy, xy2, s)):
        valid = np.isfinite(np.asarray(s)).all(1)
        if not (np.isfinite(np.asarray(xy)[valid]).all() and np.isfinite(np.asarray(xy2)[valid]).all()):
            raise ValueError("an image coordinate is not a finite number; exclude the point with an infinite sigma")
        if not (np.asarray(s) > 0).all():
            raise ValueError("a sigma is not positive; give a positive standard deviation, infinite to exclude a point")
    interiors = tuple(jnp.asarray(elements, float) for _, elements in cameras)
    number = 1 if count == 5 else samples
    options = (cameras[0][0], cameras[1][0]), robust, number
    oriented = _oriented(options, interiors, (xy, xy2, s), jnp.asarray(seed), optimised=False)
    return _answer(convention, oriented, s, jnp.asarray(base, float), optimised=False)


class Oriented(NamedTuple):
    """The orientation before its elements are named: the same for both conventions."""

    rays: Rays
    start: Pair
    at: Pair
    used: Bool[Array, " point"]
    found: Found
    size: Float[Array, ""]
    """The last step [rad]."""


@Compiled
def _oriented(options: Any, interiors: Any, given: Any, seed: Array) -> Oriented:
    """The orientation by samples of five points, and by least squares."""
    models, robust, samples = options
    first, second, s = given
    valid = jnp.isfinite(s).all(1)
    one, two = (_photo_vectors(m, i, x, s, valid) for m, i, x in zip(models, interiors, (first, second), strict=True))
    rays = Rays(one[0], two[0], one[1], two[1], valid)
    found = search(rays, jax.random.key(seed), samples)
    start = jax.tree.map(lambda x: x[0], found.pairs)
    at, used = start, valid
    if robust:

        def selected(_: Array, at: Pair) -> Pair:
            return coplanarity.refined(at, rays, coplanarity.squares(_fitting(at, rays)), SELECTION_STEPS)[0]

        at = lax.fori_loop(0, SELECTIONS, selected, at)
        used = _fitting(at, rays)
    at, size = coplanarity.refined(at, rays, coplanarity.squares(used), FINAL_STEPS)
    return Oriented(rays, start, at, used, found, size)


def _fitting(at: Pair, rays: Rays) -> Bool[Array, " point"]:
    return rays.valid & (jnp.abs(coplanarity.parallaxes(at, rays)) < REJECTED) & ~sides(at, rays)[1]


def _photo_vectors(model: CameraModel, interior: Array, x: Array, s: Array, valid: Array) -> tuple[Array, Array]:
    """Photo vectors (a, b, -1) and the covariance of (a, b), from the residuals of the camera model."""
    instead = x[jnp.argmax(valid)]  # for an unused point the correction of a distortion might not converge
    x, y = jnp.where(valid[:, None], x, instead).T
    elements = tuple(jnp.broadcast_to(element, x.shape) for element in interior)
    along = direction(model, elements, (x, y))
    plane = jnp.stack([-along[0] / along[2], -along[1] / along[2]], 1)

    def residual(ab: Array, x: Array, y: Array) -> Array:
        return jnp.stack(model.residual(tuple(interior), (ab[0], ab[1], -jnp.ones(())), (x, y)))

    back = jnp.linalg.inv(jax.vmap(jax.jacfwd(residual))(plane, x, y)) * jnp.where(valid[:, None], s, 1.0)[:, None, :]
    return jnp.concatenate([plane, -jnp.ones_like(plane[:, :1])], 1), back @ back.swapaxes(1, 2)


def _named(convention: str, at: Pair, fixed: Array, base: Array) -> tuple[Array, Array, Array, Array]:
    """The five elements, rotation of the model system, length of the base, and the second rotation in this system."""
    b = at.base
    if convention == "dependent":
        length = base / jnp.abs(b[fixed])
        angles = to_omega_phi_kappa(tuple(at.rotation.ravel()))
        others = jnp.array([[1, 2], [0, 2], [0, 1]])[fixed]
        return jnp.concatenate([length * b[others], jnp.stack(angles)]), jnp.eye(3), length, at.rotation
    phi, kappa = jnp.arctan2(b[2], jnp.hypot(b[0], b[1])), -jnp.arctan2(b[1], b[0])
    turn = jnp.stack(from_omega_phi_kappa(jnp.zeros(()), phi, kappa)).reshape(3, 3)
    second = turn @ at.rotation
    angles = to_omega_phi_kappa(tuple(second.ravel()))
    return jnp.stack([phi, kappa, *angles]), turn, base, second


@Compiled
def _answer(convention: str, oriented: Oriented, s: Float[Array, "point 2"], base: Array) -> RelativeOrientation:
    """The elements of a convention, their precision, and the model."""
    rays, start, at, used, found, size = oriented
    fixed = jnp.argmax(jnp.abs(at.base))
    cost, normals, _, _ = coplanarity.normal_equations(at, rays, coplanarity.squares(used))
    scale = 1 / jnp.sqrt(jnp.diagonal(normals))
    values, vectors = jnp.linalg.eigh(normals * scale[:, None] * scale[None])
    determined = values[0] > UNDETERMINED * values[-1]
    factor = scale[:, None] * vectors / jnp.sqrt(jnp.where(determined, values, jnp.nan))[None]

    def points(d: Array, planes: Array) -> Array:
        moved = coplanarity.changed(at, d)
        ab = planes.reshape(-1, 2, 2)
        shifted = rays._replace(first=rays.first.at[:, :2].set(ab[:, 0]), second=rays.second.at[:, :2].set(ab[:, 1]))
        _, turn, length, _ = _named(convention, moved, fixed, base)
        return length * coplanarity.model_points(moved, shifted) @ turn.T

    def elements(d: Array) -> Array:
        return _named(convention, coplanarity.changed(at, d), fixed, base)[0]

    nothing, planes = jnp.zeros(5), jnp.concatenate([rays.first[:, :2], rays.second[:, :2]], 1)
    of_elements = jax.jacfwd(elements)(nothing) @ factor
    of_unknowns = jax.jacfwd(points)(nothing, planes) @ factor
    columns = [jnp.zeros_like(planes).at[:, k].set(1.0) for k in range(4)]  # a point depends only on its rays
    of_rays = jnp.stack([jax.jvp(lambda p: points(nothing, p), (planes,), (column,))[1] for column in columns], 2)
    q = jax.vmap(jax.scipy.linalg.block_diag)(rays.first_covariance, rays.second_covariance)
    model_cofactors = of_rays @ q @ of_rays.swapaxes(1, 2) + of_unknowns @ of_unknowns.swapaxes(1, 2)
    values5, turn, length, second = _named(convention, at, fixed, base)
    redundancy = jnp.sum(used) - 5
    mean_square = jnp.mean(jnp.where(jnp.isfinite(s), s, 0.0) ** 2, 1)
    units = jnp.where(rays.valid, jnp.sqrt(2 * mean_square), jnp.nan)
    front, _ = sides(at, rays)
    other = jax.tree.map(lambda x: x[1], found.pairs)
    return RelativeOrientation(
        convention,
        values5,
        of_elements @ of_elements.T,
        jnp.stack([turn, second]),
        jnp.stack([jnp.zeros(3), length * turn @ at.base]),
        jnp.where(rays.valid[:, None], points(nothing, planes), jnp.nan),
        jnp.where(rays.valid[:, None, None], model_cofactors, jnp.nan),
        coplanarity.parallaxes(at, rays) * units,
        coplanarity.parallaxes(start, rays) * units,
        used,
        front & rays.valid,
        jnp.where(redundancy > 0, jnp.sqrt(cost / jnp.maximum(redundancy, 1).astype(float)), jnp.nan),
        redundancy,
        determined & (size < SETTLED),
        _is_parallel(at, rays, used),
        other.rotation,
        other.base,
        found.costs,
        fixed,
    )


def _is_parallel(at: Pair, rays: Rays, used: Bool[Array, " point"]) -> Bool[Array, ""]:
    """Whether fewer than half of the points have rays with an angle between them."""
    turned = rays.second @ at.rotation.T
    normal = jnp.cross(rays.first, turned)
    sine_squared = jnp.sum(normal**2, 1) / (jnp.sum(rays.first**2, 1) * jnp.sum(turned**2, 1))
    return 2 * jnp.sum(used & (sine_squared > PARALLEL**2 * angular_variance(rays))) < jnp.sum(used)
