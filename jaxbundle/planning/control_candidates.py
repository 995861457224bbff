"""Covariances of a block's points with possible positions of control.

    C_tk = F_t N^-1 F_k^T        t: selected points, k: candidates, from the factorised normal equations, column by
    column

If the datum depends on the control that is searched for, it needs a replacement: before the selection all candidates
have weak control with standard deviations `prior`.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum import with_datum
from jaxbundle.block.observation_kinds import CONTROL, observation_group
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors, problem, to_elimination_order
from jaxbundle.normals.plan.known_plans import planned
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.normals.solve_normals import solve_normals
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION, Compiled
from jaxbundle.numerics.host import on_device, on_host
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.planning.flight import CONTROL_KINDS
from jaxbundle.planning.prediction import predict, with_exact_observations

PRIOR = 1000.0  # factor of the mean standard deviation of a ray on the ground: 100.0 improves a block by 0.4 %
MAX_NUMBERS = 200_000_000  # maximum number of elements of the columns of candidates: 1.6 GB


class Candidates(NamedTuple):
    """A block and its candidates: covariances without any candidate, and the weight that each would add.

    The coordinates of candidates are those of the kind of control.
    """

    points: Int[np.ndarray, " candidate"]
    """Indices of the candidates in the block."""
    judged: Int[np.ndarray, " target"]
    variances: Float[np.ndarray, "target 3"]
    cross: Float[np.ndarray, "target 3 candidate coordinate"]
    own: Float[np.ndarray, "candidate coordinate candidate coordinate"]
    noise: Float[np.ndarray, " coordinate"]
    """Variances of a selected candidate: those of its control, corrected for the weak control."""


def candidates_of(
    block: Block,
    points: Int[np.ndarray, " candidate"],
    sigmas: tuple[float, ...],
    kind: str = "full",
    *,
    prior: float | None = None,
    judged: Int[np.ndarray, " target"] | None = None,
) -> Candidates:
    """Covariances of a block with possible control.

    Args:
        block: the block at its expected values, with the existing control.
        points: the points that may become control.
        sigmas: standard deviations of X, Y, Z of new control, object unit; 0 for errorless.
        kind: "full", "plan" or "height".
        prior: standard deviation of the weak control, object unit; unless given, 100 times that of a ray on the ground.

        judged: the points whose precision counts; by default all with unknown coordinates.

    Raises: ValueError for an unknown kind, points that do not exist, or too many candidates for the memory.

    Example:
        >>> candidates = jb.planning.candidates_of(flight.truth, np.arange(4), (0.02, 0.02, 0.03), prior=100.0)
        >>> candidates.points
        array([0, 1, 2, 3])
    """
    if kind not in CONTROL_KINDS:
        raise ValueError(f"control of kind {kind!r} is unknown; there are {', '.join(CONTROL_KINDS)}")
    count = len(block.structure.point_names)
    if not len(points) or np.min(points) < 0 or np.max(points) >= count:
        raise ValueError(f"candidates are numbers of points from 0 to {count - 1}; give one or more")
    columns = np.flatnonzero(CONTROL_KINDS[kind])
    if 3 * count * len(points) * len(columns) > MAX_NUMBERS:
        raise ValueError(f"{len(points)} candidates of {count} points need too much memory; give fewer candidates")
    weak = prior if prior is not None else PRIOR * ground_sigma(block)
    prepared = with_weak_control(block, points, weak)
    prediction = predict(prepared)
    new = np.asarray(sigmas, float)[columns]
    if (new >= weak).any():
        raise ValueError(f"control of {sigmas} is no better than the weak control of {weak:.3g}; give smaller sigmas")
    noise = np.where(new > 0, 1 / (1 / np.where(new > 0, new, 1.0) ** 2 - 1 / weak**2), 0.0)
    found = _columns(with_exact_observations(prediction.block), points, columns)
    variances = np.diagonal(np.asarray(prediction.cofactors.object_points), axis1=1, axis2=2)
    judged = np.flatnonzero(block.structure.point_free.all(1)) if judged is None else judged
    own = found[points][:, columns]
    return Candidates(np.asarray(points), judged, variances[judged], found[judged], own, noise)


def ground_sigma(block: Block) -> float:
    """Mean standard deviation of an image coordinate on the ground, object unit."""
    s, m = block.structure, block.structure.model
    centres = np.asarray(block.exterior.projection_centre)[s.ray_image]
    matrix = s.rotation_system.rotation_from_angles(*on_host(block.exterior.angles).T)
    axes = np.stack([on_host(x) for x in matrix], -1).reshape(-1, 3, 3)[:, :, 2]  # of the photographs, upwards
    depth = -np.sum(axes[s.ray_image] * (np.asarray(block.object_points)[s.ray_point] - centres), 1)
    elements = np.asarray(block.interior.elements)[s.image_camera[s.ray_image]]
    unit = elements[:, m.elements.index("pixel_size")] if "pixel_size" in m.elements else 1.0
    distance = elements[:, m.elements.index("principal_distance")] if "principal_distance" in m.elements else 1.0
    return float(np.mean(np.asarray(block.rays.sigmas)[:, 0] * unit * depth / distance))


def with_weak_control(block: Block, points: Int[np.ndarray, " candidate"], sigma: float) -> Block:
    """The block with observed coordinates of these points, with such large sigmas that they only define the datum."""
    values = np.asarray(block.object_points)[points]
    group = observation_group(CONTROL, np.asarray(points)[:, None], values, np.full(values.shape, sigma))
    free = np.ones_like(block.structure.exterior_free) if block.structure.datum.held else block.structure.exterior_free
    structure = dataclasses.replace(block.structure, datum=Datum("open"), exterior_free=free)
    return dataclasses.replace(block, structure=structure, groups=(*block.groups, group))


@Compiled
def _solved(unknowns: OrderedUnknowns, p: Problem, right: NormalVector) -> NormalVector:
    return solve_normals(unknowns, p, right)


def _columns(
    block: Block, points: Int[np.ndarray, " candidate"], coordinates: Int[np.ndarray, " coordinate"]
) -> Float[np.ndarray, "point 3 candidate coordinate"]:
    """Columns of N^-1 of the candidates, in the rows of all points."""
    block = with_datum(block)
    centres = np.asarray(block.exterior.projection_centre)
    centred = block.moved(on_device(-centres.mean(0)))
    plan = planned(block.structure, block.groups, centres, 1)
    args = to_elimination_order(plan, unknowns_of(centred)), problem(plan, centred)
    images, count = len(centres), len(block.structure.point_names)
    number = len(points) * len(coordinates)
    units = np.zeros((grid_size(number), count, 3))
    units[np.arange(number), np.repeat(points, len(coordinates)), np.tile(coordinates, len(points))] = 1.0
    nothing = np.zeros((len(units), images, 6)), np.zeros((len(units), *block.structure.interior_free.shape))
    interior = nothing[1][:, :, list(block.structure.interior_columns)]
    vectors = BlockVectors(nothing[0], interior, np.zeros((len(units), len(block.structure.parameters))), units)
    right: NormalVector = NormalVector(*map(on_device, ordered_vectors(plan, block.structure, vectors)))
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    solved = _solved(*args, right, optimised=optimised)
    tiles = np.asarray(solved.tiles).reshape(len(units), 3, -1)
    border = np.asarray(solved.border)[:, plan.layout.first_point :].reshape(len(units), -1, 3).transpose(0, 2, 1)
    found = np.concatenate([tiles, border], 2)[:number, :, plan.order.point]
    return found.reshape(len(points), len(coordinates), 3, count).transpose(3, 2, 0, 1)
