"""Iteration of plan and height: models are levelled and positioned alternately (Ackermann, Ebner, Klein 1973).

    plan      scale, kappa, X0, Y0 of each model        v_x, v_y of ground points and projection centres
    height    omega, phi, Z0 of each model              v_z of ground points, v_x, v_y, v_z of projection centres

Each half is nearly linear and has small normal equations. Rotations of the height half are about the centroid of the
ground points; it uses projection centres with all coordinates, since they stabilise phi. The limit is not the
minimum of the simultaneous adjustment: single points differ by up to one standard deviation.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.findings import Finding, in_order
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.block.wording import named
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.independent.formation import Models
from jaxbundle.independent.model_adjustment import Pairs, formed
from jaxbundle.independent.model_block import seen_points
from jaxbundle.independent.sensor_block import Seen, SensorBlock, Sensors, sensor_block
from jaxbundle.independent.started import started
from jaxbundle.numerics.host import tree_with
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment

SETTLED = 1e-8  # maximum change of a scale and of an angle in radians at convergence
MAX_ROUNDS = 30
MAX_TILT = 0.35  # rad: for larger tilts the halves are not nearly linear


def _weighted(interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    scale = interior[0]
    x, y, z = (measured[3 + k] * (scale * p[k] - measured[k]) for k in range(3))
    return x, y, z


LEVELLED = CameraModel("levelled model", ("scale",), _weighted, components=3, numbers=6)


class PlanHeight(NamedTuple):
    """The result of the function `plan_height`.

    Example:
        >>> found = jb.independent.plan_height(block)
        >>> found.object_points.shape[1]
        3
    """

    points: Int[np.ndarray, " point"]
    """Indices of the object points in the block of photographs."""
    object_points: Float[np.ndarray, "point 3"]
    """Coordinates: means of the levelled models and of observed values."""
    projection_centres: Float[np.ndarray, "image 3"]
    """Projection centres; NaN for images in no model."""
    scales: Float[np.ndarray, " model"]
    """Ratio of lengths in object and model."""
    rotations: Float[np.ndarray, "model 3 3"]
    """The rotation matrices object_from_model."""
    changes: Float[np.ndarray, " round"]
    """Maximum change of a scale or of an angle in each round."""
    models: Models
    findings: tuple[Finding, ...]

    @property
    def converged(self) -> bool:
        """Whether the iteration has converged."""
        return bool(self.changes[-1] < SETTLED)


class _State(NamedTuple):
    """Models in the object system during the iteration."""

    coordinates: Float[np.ndarray, "ray 3"]
    rotations: Float[np.ndarray, "model 3 3"]
    scales: Float[np.ndarray, " model"]
    start: Block


def plan_height(block: Block, *, pairs: Pairs | None = None) -> PlanHeight:
    """Adjusts a block by the iteration of plan and height of its independent models.

    Args:
        block: near-vertical photographs and control. Orientations that are not given are found first.
        pairs: names of the two images of each model; if None, images that follow each other in a strip.

    Returns: the coordinates at the limit of the iteration, without standard deviations; those of `adjust_models`
    are valid if both agree.

    Raises: BlockError for a block whose models cannot be formed, or are tilted by more than 20 degrees.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxbundle as jb
        >>> jb.independent.plan_height(jb.simulate(1, 3, control_sigma=0.02).block).converged
        True
    """
    require_a(Block, block, "independent.plan_height")
    prepare_jax()
    require_photographs(block, "independent.plan_height")
    block, of_start = started(block)
    models, told = formed(block, pairs)
    seen = seen_points(block, models, whole=True)
    state = _first(block, models, seen)
    _require_level(block, models, state.rotations)
    changes: list[float] = []
    of_models, adjusted = None, None
    while len(changes) < MAX_ROUNDS and (not changes or changes[-1] >= SETTLED):
        change = 0.0
        for half in ("plan", "height"):
            of_models = _block(state, models, seen, half)
            adjusted = adjust(_with_half(of_models, half), precision=False)
            state, size = _moved(state, seen, of_models, adjusted)
            change = max(change, size)
        changes.append(change)
    assert of_models is not None and adjusted is not None
    points, count = of_models.points, len(of_models.points)
    places = np.asarray(adjusted.block.object_points)
    centres = np.full((len(block.structure.image_names), 3), np.nan)
    centres[of_models.images] = places[count:]
    told = in_order((*of_start, *told, *of_models.findings))
    return PlanHeight(points, places[:count], centres, state.scales, state.rotations, np.array(changes), models, told)


def _first(block: Block, models: Models, seen: Seen) -> _State:
    """Models in the approximate orientations of their first images."""
    first = models.pair[:, 0]
    rotations = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3)[first]
    centres = np.asarray(block.exterior.projection_centre)[first]
    there = np.einsum("rij,rj->ri", rotations[seen.sensor], seen.coordinates) + centres[seen.sensor]
    return _State(there, rotations, np.ones(len(models)), block)


def _require_level(block: Block, models: Models, rotations: Float[np.ndarray, "model 3 3"]) -> None:
    tilted = np.flatnonzero(rotations[:, 2, 2] < np.cos(MAX_TILT))
    if len(tilted):
        names = block.structure.image_names
        who = named([f"{names[i]}-{names[j]}" for i, j in models.pair[tilted]])
        what = f"the iteration of plan and height needs near-vertical photographs; tilted by more than 20 deg: {who}"
        raise BlockError(
            [Problem(what, "adjust the models simultaneously: jb.independent.adjust_models(block)", "images")]
        )


def _block(state: _State, models: Models, seen: Seen, half: str) -> SensorBlock:
    """Models about the centroids of their ground points, in object axes."""
    block, count = state.start, len(models)
    ground = seen.point < len(block.structure.point_names)
    number = np.bincount(seen.sensor[ground], minlength=count)
    sums = [np.bincount(seen.sensor[ground], state.coordinates[ground, k], count) for k in range(3)]
    centroids = np.stack(sums, 1) / number[:, None]
    turned = (state.scales[:, None, None] * state.rotations)[seen.sensor]
    variances = np.einsum("rij,rjk,rik->ri", turned, seen.covariances, turned)
    plan = np.sqrt((variances[:, 0] + variances[:, 1]) / 2)
    weights = 1 / np.stack([plan, plan, np.sqrt(variances[:, 2])], 1)
    weights[:, 2] *= half == "height"
    weights[:, :2] *= ((half == "plan") | ~ground)[:, None]
    names = tuple(f"{block.structure.image_names[i]}-{block.structure.image_names[j]}" for i, j in models.pair)
    images = len(block.structure.image_names)
    sensor, within = np.full(images, -1, np.int32), np.tile(np.eye(3), (images, 1, 1))
    order = np.arange(count)
    sensor[models.pair[:, 1]], within[models.pair[:, 1]] = order, state.rotations @ models.rotation
    sensor[models.pair[:, 0]], within[models.pair[:, 0]] = order, state.rotations
    free = np.zeros((count, 6), bool)
    free[:, [0, 1, 5] if half == "plan" else [2, 3, 4]] = True
    sensors = Sensors(names, LEVELLED, centroids, np.zeros((count, 3)), free, np.ones((count, 1)), sensor, within)
    return sensor_block(
        block, seen, np.concatenate([state.coordinates - centroids[seen.sensor], weights], 1), sensors, ()
    )


def _with_half(of_models: SensorBlock, half: str) -> Block:
    """Fixes the results of the other half: heights; or plan coordinates of ground points, and scales."""
    s, count = of_models.block.structure, len(of_models.points)
    points = s.point_free.copy()
    if half == "plan":
        points[:, 2] = False
    else:
        points[:count, :2] = False
    scales = np.full(s.interior_free.shape, half == "plan")
    structure = dataclasses.replace(s, point_free=points, interior_free=scales, datum=Datum("control"))
    return dataclasses.replace(of_models.block, structure=structure)


def _moved(state: _State, seen: Seen, of_models: SensorBlock, adjusted: Adjustment) -> tuple[_State, float]:
    """The models after one half, and the maximum change of a scale or an angle."""
    block, before = adjusted.block, of_models.block
    rotations = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3)
    scales, centres = 1 / np.asarray(block.interior.elements)[:, 0], np.asarray(block.exterior.projection_centre)
    local = np.asarray(before.rays.coordinates)[:, :3]
    turned = np.einsum("rij,rj->ri", rotations[seen.sensor], local)
    there = centres[seen.sensor] + scales[seen.sensor, None] * turned
    size = max(float(np.abs(scales - 1).max()), float(np.abs(np.asarray(block.exterior.angles)).max()))
    start = _with_places(state.start, of_models, adjusted)
    return _State(there, rotations @ state.rotations, scales * state.scales, start), size


def _with_places(block: Block, of_models: SensorBlock, adjusted: Adjustment) -> Block:
    """The photographs with the points and projection centres of a half, as start of the next one."""
    places, count = np.asarray(adjusted.block.object_points), len(of_models.points)
    points, centres = np.array(block.object_points), np.array(block.exterior.projection_centre)
    points[of_models.points], centres[of_models.images] = places[:count], places[count:]
    return tree_with(lambda b: (b.object_points, b.exterior.projection_centre), block, (points, centres))
