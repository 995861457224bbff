"""Derivatives of a predicted accuracy with respect to the design parameters of a flight.

One reverse pass through the prediction gives the derivatives with respect to all values of the block; those
with respect to overlaps and flying height follow from the block as a function of them. The visibility of points is
constant: the derivatives are valid for changes that do not move points to other images.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, STATIONS
from jaxbundle.numerics.compilation import QUICKLY, RAYS_FOR_OPTIMISATION
from jaxbundle.numerics.host import on_device
from jaxbundle.planning.accuracy import Measure, control_of
from jaxbundle.planning.flight import FlightPlan
from jaxbundle.planning.prediction import predict


class Stretch(NamedTuple):
    """Relative changes of a flight: along and across its strips, and in height; 0 means no change.

    Example:
        >>> jb.planning.Stretch(height=0.1)
        Stretch(along=0.0, across=0.0, height=0.1)
    """

    along: Array | float = 0.0
    across: Array | float = 0.0
    height: Array | float = 0.0


class Derivatives(NamedTuple):
    """Derivatives of a measure with respect to design parameters."""

    value: float
    """The measure itself, in squared object units for a variance."""
    control: Int[np.ndarray, " control"]
    """Indices of the control points."""
    control_positions: Float[np.ndarray, "control 3"]
    """With respect to positions of control, per object unit."""
    control_sigmas: Float[np.ndarray, "control 3"]
    """With respect to sigmas of control, per object unit; 0 for fixed or unobserved coordinates."""
    image_sigma: float
    """With respect to a common factor of the sigmas of all rays: per 100 %."""
    navigation_sigma: float
    """With respect to a common factor of the sigmas of observed centres and attitudes: per 100 %; 0 without them."""
    forward_overlap: float
    """With respect to the forward overlap as a share: 0.01 is one percent."""
    side_overlap: float
    """With respect to the side overlap as a share."""
    height: float
    """With respect to the flying height, per object unit, with constant overlaps and control."""


def derivatives_of(block: Block, plan: FlightPlan, measure: Measure) -> Derivatives:
    """Derivatives of a measure of the predicted accuracy of a flight.

    Args:
        block: the truth of the simulated flight.
        plan: the flight, for its heading, overlaps and height.
        measure: a differentiable function of a `Prediction`, such as `mean_variance()`.

    Returns: the derivatives. To decrease the measure, change the parameters against the sign of the derivatives.
    Overlaps change the distances of stations and of all points, including control.

    Example:
        >>> found = jb.planning.derivatives_of(flight.truth, plan, jb.planning.mean_variance())
        >>> found.control_positions.shape
        (4, 3)
    """
    zero = Stretch(*map(jnp.asarray, (0.0, 0.0, 0.0)))

    def measured(block: Block, stretch: Stretch) -> Array:
        return measure(predict(stretched(block, plan, stretch)))

    block = with_datum(block)  # selected outside jit
    differentiated = jax.jit(jax.value_and_grad(measured, argnums=(0, 1)), compiler_options=_compilation(block))
    value, (by_block, by_stretch) = differentiated(block, zero)
    control = np.flatnonzero(control_of(block))
    sigmas, navigation = np.zeros((len(block.structure.point_names), 3)), 0.0
    for group, derivative in zip(block.groups, by_block.groups, strict=True):
        if group.structure.kind in (STATIONS, GNSS_STATIONS, *ATTITUDES.values()):
            navigation += float(jnp.sum(jnp.where(group.structure.observed, derivative.sigmas * group.sigmas, 0.0)))
        if group.structure.kind == CONTROL:
            observed = np.where(group.structure.observed, np.asarray(derivative.sigmas), 0.0)
            np.add.at(sigmas, group.structure.indices[:, 0], observed)
    along, across, height = (float(d) for d in by_stretch)
    return Derivatives(
        float(value),
        control,
        np.asarray(by_block.object_points)[control],
        sigmas[control],
        float(jnp.sum(by_block.rays.sigmas * block.rays.sigmas)),
        navigation,
        -along / (1 - plan.forward_overlap),
        -across / (1 - plan.side_overlap),
        height / plan.height,
    )


def _compilation(block: Block) -> dict[str, int | bool]:
    """Options of the compiler: fast compilation for small blocks."""
    return QUICKLY if len(block.structure.ray_image) < RAYS_FOR_OPTIMISATION else {}


def stretched(block: Block, plan: FlightPlan, stretch: Stretch) -> Block:
    """The block of a flight with other overlaps or another height; works with jit, grad and vmap.

    Stations and points are stretched about their centre, along and across the strips; a relative change of the height
    stretches both and raises the stations over the ground. Heights of points are constant.

    Example:
        >>> higher = jb.planning.stretched(flight.truth, plan, jb.planning.Stretch(height=0.1))
        >>> bool(higher.exterior.projection_centre[0, 2] > flight.truth.exterior.projection_centre[0, 2])
        True
    """
    angle = math.pi / 2 - plan.headings[0]
    axes = on_device(np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]))
    centres, points = block.exterior.projection_centre, block.object_points
    middle = jax.lax.stop_gradient(points[:, :2]).mean(0)
    height = 1 + stretch.height
    factors = jnp.stack([(1 + stretch.along) * height, (1 + stretch.across) * height])
    matrix = axes.T @ (factors[:, None] * axes)

    def plan_of(xyz: Array) -> Array:
        return middle[None] + (xyz[:, :2] - middle[None]) @ matrix.T

    ground = jnp.mean(centres[:, 2]) - plan.height
    raised = ground + (centres[:, 2] - ground) * height
    return eqx.tree_at(
        lambda b: (b.exterior.projection_centre, b.object_points),
        block,
        (
            jnp.concatenate([plan_of(centres), raised[:, None]], 1),
            jnp.concatenate([plan_of(points), points[:, 2:]], 1),
        ),
    )


def steepest_positions(
    block: Block, points: Int[np.ndarray, " control"], measure: Measure, reach: float, steps: int = 10
) -> tuple[Block, list[float]]:
    """Moves control points in X and Y against the gradient of a measure, as long as it decreases.

    Args:
        block: the planned block.
        points: the control points to move.
        measure: the measure to minimise.
        reach: maximum displacement of a point, object unit; its visibility must not change within it.
        steps: maximum number of steps.

    Returns: the block with its control moved, and the measure before and after each step.

    Example:
        >>> corner, measure = np.array([0]), jb.planning.mean_variance()
        >>> better, measures = jb.planning.steepest_positions(flight.truth, corner, measure, 10.0, steps=1)
        >>> bool(measures[-1] <= measures[0])
        True
    """
    block = with_datum(block)  # selected outside jit
    start = np.asarray(block.object_points)[points, :2]

    def of_positions(xy: Array) -> Array:
        return measure(predict(_with_positions(block, points, xy)))

    measured = jax.jit(jax.value_and_grad(of_positions), compiler_options=_compilation(block))

    xy, values = start, []
    value, gradient = (np.asarray(x) for x in measured(jnp.asarray(xy)))
    values.append(float(value))
    step = reach / 4 / max(float(np.abs(gradient).max()), 1e-300)
    for _ in range(steps):
        trial = start + np.clip(xy - step * gradient - start, -reach, reach)
        new, new_gradient = (np.asarray(x) for x in measured(jnp.asarray(trial)))
        if new < value:
            xy, value, gradient, step = trial, new, new_gradient, 1.5 * step
            values.append(float(value))
        else:
            step /= 4
    return _with_positions(block, points, jnp.asarray(xy)), values


def _with_positions(block: Block, points: Int[np.ndarray, " control"], xy: Array) -> Block:
    return eqx.tree_at(lambda b: b.object_points, block, block.object_points.at[points, :2].set(xy))
