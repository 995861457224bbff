"""The datum defect: which of origin (3), axes (3) and scale (1) of the object system are not determined.

A similarity transformation with the seven small parameters (t, r, m), about the block's centre of gravity and in units
of its radius,

    X' = X + t + r x X + m X,        R' = (I + [r]) R

does not change any image point. So the datum is defined exactly by the rows that do change: control coordinates,
observed stations, distances, fixed elements. These rows may also depend on parameters p, such as a shift of the
navigation data, which can compensate for the effect of the transformation:

    A = [dv/d(t, r, m)  dv/dp]        defect = 7 + number of p - rank A

The derivatives are computed by autodiff for any kind of observation. They are taken at the observed coordinates of
points and stations, not at approximate ones: whether control lies on a line is a property of the control.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.observed_places import Frame, frame_of, observed_places
from jaxbundle.block.problems import Problem
from jaxbundle.block.residuals import Group, group_arrays, group_residuals, weighted
from jaxbundle.block.similarity_defect import (
    RANK_TOLERANCE,
    SimilarityDefect,
    displacements,
    null_space_of,
    similarity_defect,
)
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, on_host
from jaxbundle.numerics.shapes import MIN_MEMBERS, MIN_POINTS, grid_size, padded

AT_REST = 1e-6  # share of the radius: a position with a smaller displacement is at rest
MAX_NAMED = 3


@dataclass(frozen=True)
class DatumDefect:
    """The undetermined part of the datum; `count` includes combinations of the block's parameters.

    `parameters`: names of parameters of the block that are involved; `moves`: points with the maximum displacements;
    `fixed`: observed points and images without displacement, such as control points on the axis of a rotation;
    `directions`: undetermined directions of (t, r, m), an orthonormal column each.

    Example:
        >>> jb.blocks.datum_defect(block).count
        0
    """

    count: int
    similarity: SimilarityDefect
    parameters: tuple[str, ...] = ()
    moves: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    directions: Float[np.ndarray, "7 defect"] = field(
        default_factory=lambda: np.zeros((7, 0)), compare=False, repr=False
    )

    @property
    def scale(self) -> bool:
        """Whether the scale is undetermined."""
        return self.similarity.scale

    @property
    def words(self) -> str:
        """The undetermined parameters in words."""
        own = self.count - self.similarity.count
        of_block = [f"{own} of the parameters"] if self.parameters and own > 0 else []
        return ", ".join([*([self.similarity.words] if self.similarity.count else []), *of_block])


def transformed(unknowns: Unknowns, parameters: Float[Array, "7"], radius: Array) -> Unknowns:
    """The block after a small similarity transformation (first order) of a block centred at its centre of gravity."""
    t, r, m = parameters[:3], parameters[3:6], parameters[6]

    def moved(x: Float[Array, "3 any"]) -> Float[Array, "3 any"]:
        turned = jnp.stack([r[1] * x[2] - r[2] * x[1], r[2] * x[0] - r[0] * x[2], r[0] * x[1] - r[1] * x[0]])
        return x + t[:, None] * radius + turned + m * x

    turn = rotation.from_rotation_vector(r[0], r[1], r[2])
    matrix = jnp.stack(rotation.product(turn, tuple(unknowns.rotation)))
    return Unknowns(matrix, moved(unknowns.centre), unknowns.interior, unknowns.parameters, moved(unknowns.points))


class _Carriers(NamedTuple):
    """What determines the datum: groups of observations, and points and images with a fixed element.

    Arrays are padded, so blocks with equal kinds of observations share a program.
    """

    unknowns: Unknowns
    groups: tuple[Group, ...]
    exterior_free: Bool[Array, "6 image"]
    point_free: Bool[Array, "3 point"]
    fixed: Int[Array, " point"]
    held: Int[Array, " image"]
    radius: Float[Array, ""]


class _Rows(NamedTuple):
    """Derivatives with respect to the datum and the parameters: of the coordinates of points with a fixed one, of the
    exterior elements of images with a fixed one, and of the observations, also with their weights.

    In units of the block's radius. Rows of free elements and of padding are 0.
    """

    points: Float[Array | np.ndarray, "3 point *column"]
    exterior: Float[Array | np.ndarray, "6 image *column"]
    observed: Float[Array | np.ndarray, "row *column"]
    weighted: Float[Array | np.ndarray, "weighted_row *column"]


@Compiled
def _datum_rows(system: RotationSystem, carriers: _Carriers) -> _Rows:
    unknowns, groups, exterior_free, point_free, fixed, held, radius = carriers

    def joined(parts: list[Float[Array, "_component _member"]]) -> Float[Array, " row"]:
        return jnp.concatenate([part.ravel() for part in parts]) if parts else jnp.zeros(0)

    def carried(changes: Float[Array, " column"]) -> _Rows:
        moved = transformed(unknowns, changes[:7], radius)
        moved = Unknowns(moved.rotation, moved.centre, moved.interior, moved.parameters + changes[7:], moved.points)
        angles = jnp.stack(system.angles_from_rotation(tuple(moved.rotation[:, held])))
        exterior = jnp.concatenate([moved.centre[:, held] / radius, angles])
        residuals = [group_residuals(moved, group) for group in groups]
        observed = [jnp.where(_is_observed(group), v, 0.0) / radius for v, group in zip(residuals, groups, strict=True)]
        return _Rows(
            jnp.where(point_free[:, fixed], 0.0, moved.points[:, fixed]) / radius,
            jnp.where(exterior_free[:, held], 0.0, exterior),
            joined(observed),
            joined([weighted(v, group) for v, group in zip(residuals, groups, strict=True)]),
        )

    return jax.jacfwd(carried)(jnp.zeros(7 + unknowns.parameters.shape[0]))


def _is_observed(group: Group) -> Bool[Array, "component member"]:
    """Mask of the observed components, which have a weight."""
    own = group.weights if group.weights.ndim == 2 else jnp.diagonal(group.weights).T
    return own > 0


class DatumEquations(NamedTuple):
    """Derivatives of fixed elements and observations with respect to (t, r, m) and the parameters, with a mask."""

    fixed: Float[np.ndarray, "held column"]
    observed: Float[np.ndarray, "row column"]
    weighted: Float[np.ndarray, "row column"]
    free: Bool[np.ndarray, " column"]
    frame: Frame


def datum_equations(block: Block) -> DatumEquations:
    """The rows that define the datum, at the observed positions.

    A row without a finite derivative, such as the azimuth of a plumb line, is set to 0.
    """
    structure, frame = block.structure, frame_of(block)
    free = np.concatenate([np.ones(7, bool), structure.parameter_free])
    if not block.groups and structure.point_free.all() and structure.exterior_free.all():
        nothing = np.zeros((0, len(free)))
        return DatumEquations(nothing, nothing, nothing, free, frame)
    rows = _rows(block, frame, structure.point_free, structure.exterior_free)
    fixed = np.concatenate([part.reshape(-1, len(free)) for part in (rows.points, rows.exterior)])
    return DatumEquations(fixed, np.asarray(rows.observed), np.asarray(rows.weighted), free, frame)


def _rows(
    block: Block, frame: Frame, point_free: Bool[np.ndarray, "point 3"], exterior_free: Bool[np.ndarray, "image 6"]
) -> _Rows:
    """The rows of a block in which these elements are free, on the host."""
    moved = block.moved(-frame.centre)
    u = unknowns_of(moved)
    arrays = (
        *(padded(u.rotation), padded(frame.centres.T), padded(u.interior, 1), padded(frame.points.T, MIN_POINTS)),
        *(padded(exterior_free.T), padded(point_free.T, MIN_POINTS)),
        *(_padded_indices(np.asarray(~free.all(1))) for free in (point_free, exterior_free)),
        np.asarray(frame.radius),
    )
    rotations, centres, interior, points, *others = on_device(arrays)
    groups = tuple(
        group_arrays(group, group.structure.indices.T, grid_size(group.values.shape[0], MIN_MEMBERS))
        for group in moved.groups
    )
    carriers = _Carriers(Unknowns(rotations, centres, interior, u.parameters, points), groups, *others)
    rows = on_host(_datum_rows(block.structure.rotation_system, carriers, optimised=False))
    return _Rows(*(np.where(np.isfinite(x).all(-1, keepdims=True), x, 0.0) for x in rows))


def _padded_indices(mask: Bool[np.ndarray, " entity"]) -> Int[np.ndarray, " padded"]:
    """Indices where the mask is true, padded with the first entity, whose rows are 0 if it is free."""
    index = np.nonzero(mask)[0]
    filled = np.full(grid_size(len(index)), np.argmin(mask), np.int32)
    filled[: len(index)] = index
    return filled


def _null_space(equations: DatumEquations) -> Float[np.ndarray, "column defect"]:
    """Directions of (t, r, m) and of the block's parameters that no observation and no fixed element determines."""
    free, rows = equations.free, np.concatenate([equations.fixed, equations.observed])
    # angles and lengths count equally: rows above the rounding level are scaled to the length 1
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = np.where(size > RANK_TOLERANCE * size.max(initial=0.0), rows / np.where(size > 0, size, 1.0), 0.0)
    # the unit of a parameter is arbitrary: its column is scaled to the length of the columns of the seven
    length = np.concatenate([np.ones(7), np.linalg.norm(rows[:, 7:], axis=0)])
    scale = np.where(free & (length > 0), 1 / np.where(length > 0, length, 1.0), 1.0)
    found = null_space_of((rows * scale)[:, free])
    directions = np.zeros((len(free), found.shape[1]))
    directions[free] = found
    return directions * scale[:, None]


def datum_defect(block: Block) -> DatumDefect:
    """The datum defect that control, observed stations, distances and fixed elements leave.

    Example:
        >>> jb.blocks.datum_defect(block).count
        0
    """
    require_a(Block, block, "blocks.datum_defect")
    equations = datum_equations(block)
    directions = _null_space(equations)
    names = [parameter.name for parameter in block.structure.parameters]
    taking_part = np.abs(directions[7:]).max(1, initial=0.0) > RANK_TOLERANCE
    own = tuple(name for name, part in zip(names, taking_part, strict=True) if part)
    left, size, _ = np.linalg.svd(directions[:7], full_matrices=False)
    datum = left[:, : int((size > RANK_TOLERANCE).sum())]
    some = datum.shape[1] not in (0, 7)
    moves, fixed = _moved_and_fixed(block, equations.frame, datum) if some else ((), ())
    return DatumDefect(directions.shape[1], similarity_defect(datum), own, moves, fixed, datum)


def sensitivity(
    block: Block, defect: DatumDefect, elements: list[tuple[int, int]]
) -> Float[np.ndarray, "element defect"]:
    """Derivatives of elements of images, given as (image, element), along the undetermined directions of the datum.

    Coordinates in units of the block's radius, angles in radians.
    """
    images, components = np.array(elements).T
    free = np.ones(block.structure.exterior_free.shape, bool)
    free[images] = False
    rows = _rows(block, frame_of(block), np.ones(block.structure.point_free.shape, bool), free)
    of_images = np.asarray(rows.exterior)[components, np.searchsorted(np.unique(images), images), :7]
    return of_images @ defect.directions


def _moved_and_fixed(
    block: Block, frame: Frame, datum: Float[np.ndarray, "7 defect"]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Points with the maximum displacement along undetermined directions, and observed points and stations at rest."""
    moved = np.linalg.norm(displacements(datum, frame.points, frame.radius), axis=(0, 2))
    moved = np.where(np.isfinite(moved), moved, -1.0)
    most = tuple(block.structure.point_names[p] for p in np.argsort(-moved, kind="stable")[:MAX_NAMED])
    observed = observed_places(block, frame)
    places = np.array([place for *_, place in observed]).reshape(-1, 3)
    size = np.linalg.norm(displacements(datum, places, frame.radius), axis=(0, 2))
    return most, tuple(observed[k][1] for k in np.flatnonzero(size <= AT_REST * frame.radius))


def _shortened(names: tuple[str, ...]) -> str:
    return ", ".join(names[:MAX_NAMED]) + (" ..." if len(names) > MAX_NAMED else "")


def insufficient(defect: DatumDefect) -> Problem:
    """The problem of a datum that control determines only partly."""
    own = ""
    if defect.parameters:
        own = f"; parameters involved: {_shortened(defect.parameters)}"
    if len(defect.fixed) > 1 and len(defect.similarity.axes) == 1 and defect.count == 1:
        own += f"; these lie on one line, the axis: {_shortened(defect.fixed)}"
    moves = f"; points with the maximum displacements: {', '.join(defect.moves)}" if defect.moves else ""
    cure = (
        "a block needs at least two points with X, Y, Z and a third one with Z that is not on a line with them,"
        " or observed stations that are not on one line"
    )
    if defect.parameters:
        cure += "; fix the parameters or give them a value with a sigma, or add control"
    return Problem(
        f"the control leaves {defect.count} of the {7 if not defect.parameters else 'datum and navigation'} parameters"
        f"{' of the datum' if not defect.parameters else ''} undetermined: {defect.words}{own}{moves}",
        cure,
        "control",
    )
