"""Absolute orientation: the similarity from a model to the object system by full, plan and height control.

Seven unknowns require at least 2 plan positions and 3 heights. With minimal control several orientations can exist: 2
full points and one height always have two. All are returned; the projection centres decide which one is chosen.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.geometry.similarity import Similarity, similarity
from jaxbundle.numerics.host import is_concrete
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.orientation.fitted_similarity import Control, Fit, all_fits, changed, residuals

MAX_SOLUTIONS = 4
DISTINCT = 1e-4  # differences of rotation matrices and logarithms of scales: below this two minima are equal
UNDETERMINED = 1e-10  # ratio of minimum and maximum eigenvalue of the normal equations with a unit diagonal
ON_A_LINE = 1e-3  # ratio of the extents across and along a line
ALIKE = 9.0  # in units of sigma0^2: orientations with a smaller increase of the sum of squares are possible (3 sigma)
# ratio of third and first singular value: below this the points are in a plane, which has no mirror image
MIRRORED_PART = 1e-3


class AbsoluteOrientation(eqx.Module):
    """Result of `absolute_orientation`. Angles in radians, lengths in the unit of the object system.

    Example:
        >>> model = [[0, 0, 5], [0, 2, 5], [-2, 0, 5], [-2, 2, 5.2]]
        >>> found = jb.orientation.absolute_orientation(model, 3.0 * np.array(model) + 10.0)
        >>> round(float(found.similarity.scale), 6), bool(found.determined)
        (3.0, True)
    """

    similarity: Similarity
    """The chosen orientation."""
    angles: Float[Array, "*model 3"]
    """Angles of its rotation object_from_model."""
    cofactors: Float[Array, "*model 7 7"]
    """Cofactors of scale, three angles and three translations; NaN if the control does not determine them."""
    residuals: Float[Array, "*model point 3"]
    """Residuals transformed - given; 0 for coordinates that are not given."""
    sigma0: Float[Array, "*model"]
    """A-posteriori standard deviation of unit weight; NaN without redundancy."""
    redundancy: Array
    """Number of observed coordinates minus 7."""
    solutions: Similarity
    """Up to four orientations with minimal sums of squares, in increasing order; NaN if there are fewer."""
    costs: Float[Array, "*model 4"]
    """Weighted sums of squares of `solutions`."""
    possible: Bool[Array, "*model 4"]
    """Mask of the solutions that the control cannot distinguish from the best one."""
    chosen: Array
    """Index of `similarity` in `solutions`."""
    determined: Bool[Array, "*model"]
    """Whether the control determines all seven unknowns."""
    on_a_line: Bool[Array, "*model"]
    """Whether the control lies on a straight line."""
    mirrored: Bool[Array, "*model"]
    """Whether the full control is the mirror image of the model."""

    @property
    def standard_deviations(self) -> Float[Array, "*model 7"]:
        """A-posteriori standard deviations of scale, three angles and three translations."""
        return self.sigma0[..., None] * jnp.sqrt(jnp.diagonal(self.cofactors, axis1=-2, axis2=-1))

    @property
    def words(self) -> str:
        """Problem and cure of the orientation of one model (concrete results only); empty if there is none."""
        if self.mirrored:
            return "the control is a mirror image of the model; check for exchanged or negated coordinates"
        if self.on_a_line:
            return "the control lies on a line, the rotation about it is not determined; add control off the line"
        if not self.determined:
            return "the control does not determine the orientation; add plan positions and heights at other positions"
        number = int(self.possible.sum())
        if number > 1:
            return (
                f"{number} orientations fit the control; solution {int(self.chosen) + 1} is chosen; add control, or"
                " give the projection centres, which lie above the points of an aerial model"
            )
        return ""


def absolute_orientation(
    model_points: Real[ArrayLike, "point 3"] | Nested,
    object_points: Real[ArrayLike, "point 3"] | Nested,
    sigmas: Real[ArrayLike, "..."] | Nested = 1.0,
    *,
    model_sigmas: Real[ArrayLike, "..."] | Nested = 0.0,
    projection_centres: Real[ArrayLike, "image 3"] | Nested | None = None,
    system: RotationSystem = OMEGA_PHI_KAPPA,
) -> AbsoluteOrientation:
    """The similarity from a model to the object system, by least squares with weights on both sides.

    Args:
        model_points: model coordinates of the control, one row per point.
        object_points: X, Y, Z of the control; NaN where a coordinate is not given (plan or height control).
        sigmas: standard deviations of the object coordinates, one number or one per coordinate.
        model_sigmas: standard deviations of the model coordinates, likewise, or covariances (point, 3, 3).
        projection_centres: in the model; from several possible orientations the one with the centres above the
            points is chosen. Without them the one with the minimum sum of squares is chosen.
        system: rotation system of the angles.

    Returns: the orientation, its precision and all alternatives. It works with jit and vmap.

    Raises: ValueError for too little control, for a sigma that is not positive, or without float64.

    Example:
        >>> import jaxbundle as jb
        >>> model = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1]]
        >>> found = jb.orientation.absolute_orientation(model, [[0, 0, 5], [0, 2, 5], [-2, 0, 5], [-2, 2, 5.2]])
        >>> round(float(found.similarity.scale), 6)
        2.0
    """
    prepare_jax()
    if (
        np.ndim(model_points) != 2
        or np.shape(model_points) != np.shape(object_points)
        or np.shape(model_points)[1] != 3
    ):
        raise ValueError(
            f"model points of shape {np.shape(model_points)} and object points of shape {np.shape(object_points)}; give"
            " three coordinates for each point in both systems, NaN where an object coordinate is not given"
        )
    count = np.shape(model_points)[0]
    x, o = jnp.asarray(model_points, float), jnp.asarray(object_points, float)
    s, m = jnp.broadcast_to(jnp.asarray(sigmas, float), (count, 3)), jnp.asarray(model_sigmas, float)
    covariance = m if m.ndim == 3 else jnp.broadcast_to(m, (count, 3))[:, :, None] ** 2 * jnp.eye(3)[None]
    centres = jnp.full((1, 3), jnp.nan) if projection_centres is None else jnp.asarray(projection_centres, float)
    if is_concrete((x, o, s, m)):
        _require_values(np.asarray(x), np.asarray(o), np.asarray(s), np.asarray(covariance))
    return _orientation(system, x, o, s, covariance, centres)


def _require_values(x: np.ndarray, o: np.ndarray, s: np.ndarray, covariance: np.ndarray) -> None:
    given = np.isfinite(o)
    if not np.isfinite(x).all():
        raise ValueError("a model coordinate is not a finite number; leave the point out")
    plan, heights = int(given[:, :2].all(1).sum()), int(given[:, 2].sum())
    if plan < 2 or heights < 3 or given.sum() < 7:
        raise ValueError(
            f"{plan} plan positions and {heights} heights do not determine an absolute orientation; give at least 2"
            " and 3"
        )
    variances = s**2 + np.trace(covariance, axis1=1, axis2=2)[:, None]
    if not (s[given] >= 0).all() or not (variances[given] > 0).all():
        raise ValueError("a standard deviation is not positive; give positive ones for either system")


@eqx.filter_jit
def _orientation(
    system: RotationSystem,
    x: Float[Array, "point 3"],
    o: Float[Array, "point 3"],
    s: Float[Array, "point 3"],
    covariance: Float[Array, "point 3 3"],
    centres: Float[Array, "image 3"],
) -> AbsoluteOrientation:
    c, centred = _normalised(x, o, s, covariance)
    full = c.observed.all(1)
    closed = similarity(
        c.model, c.object_points, full.astype(float) / jnp.sum(jnp.where(c.observed, s, 0.0) ** 2 + 1e-300, 1)
    )
    enough = jnp.sum(full) >= 3
    first = jax.tree.map(lambda value: jnp.where(enough, value, jnp.nan), closed.similarity)
    fits, cost, distinct = _distinct(all_fits(first, c))
    redundancy = jnp.sum(c.observed) - 7
    divisor = jnp.maximum(redundancy, 1).astype(float)
    variance = jnp.where(redundancy > 0, cost[0] / divisor, 0.0)
    weighted = jnp.where(c.observed, c.object_points, 0.0) / jnp.sqrt(
        jnp.diagonal(c.object_covariance + c.model_covariance, axis1=1, axis2=2)
    )
    rounding = 1e-12 * jnp.sum(weighted**2)  # a millionth of the extent of the points
    possible = distinct & (cost <= cost[0] + ALIKE * variance + rounding)
    chosen = _chosen(fits.similarity, possible, c.model, centred.model(centres))
    fit = jax.tree.map(lambda value: value[chosen], fits)
    determined, cofactors, at, angles = _precision(fit, system, centred)
    solutions = jax.vmap(centred.back)(fits.similarity)
    solutions = jax.tree.map(lambda v: jnp.where(distinct.reshape(-1, *[1] * (v.ndim - 1)), v, jnp.nan), solutions)
    extents = jnp.linalg.svd(c.model - c.model.mean(0, keepdims=True), compute_uv=False)
    d = closed.singular_values
    return AbsoluteOrientation(
        at,
        angles,
        cofactors,
        residuals(fit.similarity, c) * centred.object_size,
        jnp.where(redundancy > 0, jnp.sqrt(fit.cost / divisor), jnp.nan),
        redundancy,
        solutions,
        jnp.where(distinct, cost, jnp.nan),
        possible,
        chosen,
        determined,
        extents[1] < ON_A_LINE * extents[0],
        enough & closed.mirrored & (d[2] > MIRRORED_PART * d[0]),
    )


class _Centred(eqx.Module):
    """Origins and scales of both systems during the adjustment."""

    model_origin: Float[Array, "3"]
    model_size: Float[Array, ""]
    object_origin: Float[Array, "3"]
    object_size: Float[Array, ""]

    def model(self, points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Model coordinates relative to their centre."""
        return (points - self.model_origin[None]) / self.model_size

    def back(self, at: Similarity) -> Similarity:
        """The similarity between the original systems."""
        scale = at.scale * self.object_size / self.model_size
        shift = self.object_origin + self.object_size * at.translation - scale * at.rotation @ self.model_origin
        return Similarity(scale, at.rotation, shift)


def _normalised(x: Array, o: Array, s: Array, covariance: Array) -> tuple[Control, _Centred]:
    observed = jnp.isfinite(o)
    origin = jnp.sum(jnp.where(observed, o, 0.0), 0) / jnp.maximum(jnp.sum(observed, 0), 1).astype(float)
    reduced = jnp.where(observed, o - origin[None], 0.0)
    size, centre = jnp.sqrt(jnp.sum(reduced**2) / jnp.sum(observed).astype(float)), x.mean(0)
    model_size = jnp.sqrt(jnp.mean((x - centre[None]) ** 2))
    centred = _Centred(centre, model_size, origin, size)
    variances = jnp.where(observed, s, 1.0)[:, :, None] ** 2 * jnp.eye(3)[None]
    return Control(centred.model(x), reduced / size, observed, covariance / model_size**2, variances / size**2), centred


def _distinct(fits: Fit) -> tuple[Fit, Float[Array, "4"], Bool[Array, "4"]]:
    """The best different minima, in increasing order of the sum of squares."""
    cost = jnp.where(fits.converged & jnp.isfinite(fits.cost), fits.cost, jnp.inf)
    order = jnp.argsort(cost)
    fits, cost = jax.tree.map(lambda value: value[order], (fits, cost))
    at = fits.similarity
    coordinates = jnp.concatenate([at.rotation.reshape(-1, 9), jnp.log(at.scale)[:, None]], 1)
    apart = jnp.linalg.norm(coordinates[:, None] - coordinates[None], axis=2) > DISTINCT
    number = len(cost)
    kept = jnp.isfinite(cost)
    for i in range(1, number):
        kept = kept.at[i].set(kept[i] & jnp.all(apart[i, :i] | ~kept[:i]))
    first = jnp.argsort(~kept)[:MAX_SOLUTIONS]
    fits, cost, kept = jax.tree.map(lambda value: value[first], (fits, cost, kept))
    return fits, cost, kept


def _chosen(at: Similarity, possible: Bool[Array, "4"], points: Array, centres: Array) -> Array:
    """The first possible solution with the centres above the points, otherwise the first one."""
    above = jnp.mean(at(centres)[..., 2], 1) > jnp.mean(at(points)[..., 2], 1)  # False without centres
    return jnp.argmin(jnp.where(possible & above, 0, jnp.where(possible, 1, 2)))


def _precision(fit: Fit, system: RotationSystem, centred: _Centred) -> tuple[Array, Array, Similarity, Array]:
    """Whether all elements are determined; cofactors of the seven elements; these elements."""
    scale = 1 / jnp.sqrt(jnp.diagonal(fit.normals))
    values, vectors = jnp.linalg.eigh(fit.normals * scale[:, None] * scale[None])
    determined = values[0] > UNDETERMINED * values[-1]
    factor = scale[:, None] * vectors / jnp.sqrt(jnp.where(determined, values, jnp.nan))[None]

    def elements(d: Array) -> tuple[Array, Similarity]:
        at = centred.back(changed(fit.similarity, d))
        angles = system.angles_from_rotation(tuple(at.rotation.ravel()))
        return jnp.concatenate([at.scale[None], jnp.stack(angles), at.translation]), at

    derivative = jax.jacfwd(lambda d: elements(d)[0])(jnp.zeros(7)) @ factor
    values, at = elements(jnp.zeros(7))
    return determined, derivative @ derivative.T, at, values[1:4]
