"""Measures of a predicted precision, and the check of a specification.

Measures are differentiable functions of variances, so that `jax.grad` of a measure works for all values of the block.
They use the unknown coordinates of points that are not control.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.numerics.host import array_module, on_host
from jaxbundle.planning.flight import FlightPlan
from jaxbundle.planning.ground import inside
from jaxbundle.planning.prediction import Prediction

Measure = Callable[[Prediction], Array]
Points = Bool[np.ndarray, " point"]
Weights = tuple[float, float, float]
EQUAL = (1.0, 1.0, 1.0)


class Specification(NamedTuple):
    """A specification: maximum standard deviations of X, Y (each) and Z, object unit, for a share of the points.

    Example:
        >>> jb.planning.Specification(xy=0.05, z=0.08).share
        0.95
    """

    xy: float
    z: float
    share: float = 0.95


class Check(NamedTuple):
    """The check of a prediction against a specification.

    Example:
        >>> check = jb.planning.check_specification(prediction, jb.planning.Specification(xy=1.0, z=2.0))
        >>> check.passed
        True
    """

    share_xy: float
    share_z: float
    share: float
    """Share of the points that meet both limits."""
    passed: bool


class Summary(NamedTuple):
    """Statistics of the predicted standard deviations of the selected points, object unit; `worst`: names of points."""

    judged: int
    """Number of points."""
    rms: Float[np.ndarray, "3"]
    median: Float[np.ndarray, "3"]
    maximum: Float[np.ndarray, "3"]
    worst: tuple[str, str, str]


def control_of(block: Block) -> Bool[np.ndarray, " point"]:
    """Mask of the points with an observed or fixed coordinate."""
    structure = block.structure
    found = np.array(~structure.point_free.all(1))
    for group in block.groups:
        if group.structure.kind == CONTROL:
            members = group.structure.observed.any(1)
            found[group.structure.indices[members, 0]] = True
    return found


def judged_points(block: Block) -> Bool[np.ndarray, " point"]:
    """Mask of the points of a measure: all but control points; all points if there are only control points."""
    control = control_of(block)
    return ~control if not control.all() else np.ones_like(control)


def in_area(block: Block, plan: FlightPlan) -> Points:
    """Mask of the relevant points of a flight: within its area, if there is one, and not control.

    Example:
        >>> jb.planning.in_area(flight.truth, plan).dtype
        dtype('bool')
    """
    judged = judged_points(block)
    if not plan.area:
        return judged
    return judged & inside(np.asarray(plan.area, float), np.asarray(block.object_points)[:, :2])


def point_variances(prediction: Prediction, points: Points | None = None) -> Float[Array | np.ndarray, "chosen 3"]:
    """Variances of X, Y, Z of the selected points; infinite where unknowns are undetermined."""
    blocks = prediction.cofactors.object_points
    xp = array_module(blocks)
    chosen = np.flatnonzero(judged_points(prediction.block) if points is None else points)
    if prediction.undetermined:
        return np.full((len(chosen), 3), np.inf)
    return xp.diagonal(on_host(blocks), axis1=1, axis2=2)[chosen]


def mean_variance(weights: Weights = EQUAL, points: Points | None = None) -> Measure:
    """The mean variance of the selected points, X, Y and Z weighted: the criterion A of optimal design.

    Example:
        >>> bool(jb.planning.mean_variance()(prediction) > 0)
        True
    """
    w = np.asarray(weights) / np.sum(weights)
    return lambda prediction: jnp.mean(point_variances(prediction, points) @ w)


def smooth_worst(sharpness: float = 20.0, weights: Weights = EQUAL, points: Points | None = None) -> Measure:
    """A smooth maximum of the weighted variances of the points, (1/beta) log mean exp(beta variance).

    beta is `sharpness` divided by the maximum variance: the result is at most log(points) / beta below the maximum.

    Example:
        >>> bool(jb.planning.smooth_worst()(prediction) > jb.planning.mean_variance()(prediction))
        True
    """
    w = np.asarray(weights) / np.sum(weights)

    def measure(prediction: Prediction) -> Array:
        variances = jnp.asarray(point_variances(prediction, points) @ w)
        if prediction.undetermined:
            return variances.max()
        beta = sharpness / jax.lax.stop_gradient(variances.max())
        return (jax.scipy.special.logsumexp(beta * variances) - jnp.log(len(variances))) / beta

    return measure


def smooth_share(specification: Specification, width: float = 0.1, points: Points | None = None) -> Measure:
    """The share of points within a specification, each counted by a logistic step of this relative width.

    Example:
        >>> round(float(jb.planning.smooth_share(jb.planning.Specification(xy=1.0, z=2.0))(prediction)), 3)
        1.0
    """
    limits = np.array([specification.xy, specification.xy, specification.z])

    def measure(prediction: Prediction) -> Array:
        deviations = jnp.sqrt(point_variances(prediction, points))
        worst = jnp.max(deviations / limits[None], axis=1)
        return jnp.mean(jax.nn.sigmoid((1 - worst) / width))

    return measure


def check_specification(prediction: Prediction, specification: Specification, points: Points | None = None) -> Check:
    """Checks whether enough points meet a specification; `points`: by default all but control.

    Raises: ValueError for limits that are not positive or a share that is not from 0 to 1.

    Example:
        >>> jb.planning.check_specification(prediction, jb.planning.Specification(xy=1e-6, z=1e-6)).share
        0.0
    """
    if not (specification.xy > 0 and specification.z > 0 and 0 < specification.share <= 1):
        raise ValueError(f"{specification}: give positive limits in the object unit and a share from 0 to 1")
    deviations = np.sqrt(np.asarray(point_variances(prediction, points)))
    plan, height = (deviations[:, :2] <= specification.xy).all(1), deviations[:, 2] <= specification.z
    both = float((plan & height).mean())
    return Check(float(plan.mean()), float(height.mean()), both, both >= specification.share)


def summary_of(prediction: Prediction, points: Points | None = None) -> Summary:
    """A few statistics of the selected points, by default all but control.

    Example:
        >>> type(jb.planning.summary_of(prediction)).__name__
        'Summary'
    """
    points = judged_points(prediction.block) if points is None else points
    deviations = np.sqrt(np.asarray(point_variances(prediction, points)))
    names = np.array(prediction.block.structure.point_names)[points]
    x, y, z = (str(name) for name in names[deviations.argmax(0)])
    rms = np.sqrt((deviations**2).mean(0))
    return Summary(len(names), rms, np.median(deviations, axis=0), deviations.max(0), (x, y, z))
