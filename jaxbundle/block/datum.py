"""The datum: what fixes origin (3), axes (3) and scale (1) of the object system.

A similarity transformation with the seven small parameters (t, r, m), about the block's centre of gravity and in units
of its radius,

    X' = X + t + r x X + m X,        R' = (I + [r]) R

leaves every image point where it is. So the datum is defined exactly by those rows that do change: control
coordinates, observed stations, distances, held elements. The defect is 7 less the rank of their derivatives with
respect to (t, r, m); the derivatives come from autodiff, whatever kinds of observation there are.
"""

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.residuals import Observations, group_residuals, observations_of
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.geometry import rotation
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size

RANK_TOLERANCE = 1e-8  # singular values are of order 1 for control spread over the block


@dataclass(frozen=True)
class DatumDefect:
    """Number of undetermined datum parameters and their description in words."""

    count: int
    words: str


def _transformed(unknowns: Unknowns, parameters: Float[Array, "7"], radius: Array) -> Unknowns:
    """The block after a small similarity transformation (first order) of a block centred at its centre of gravity."""
    t, r, m = parameters[:3], parameters[3:6], parameters[6]

    def moved(x: Float[Array, "3 any"]) -> Float[Array, "3 any"]:
        turned = jnp.stack([r[1] * x[2] - r[2] * x[1], r[2] * x[0] - r[0] * x[2], r[0] * x[1] - r[1] * x[0]])
        return x + t[:, None] * radius + turned + m * x

    turn = rotation.from_rotation_vector(r[0], r[1], r[2])
    matrix = jnp.stack(rotation.product(turn, tuple(unknowns.rotation)))
    return Unknowns(matrix, moved(unknowns.centre), unknowns.interior, moved(unknowns.points))


def _datum_rows(
    unknowns: Unknowns, observations: Observations, fixed: Int[Array, " point"], held: Int[Array, " image"]
) -> Float[Array, "row 7"]:
    """Derivatives of what carries the datum with respect to the seven parameters, in units of the block's radius.

    `fixed`, `held`: points and images of which an element is held; what of them is free counts nothing.
    """
    radius = jnp.sqrt(jnp.mean(jnp.sum(unknowns.points**2, 0)))
    o = observations

    def carried(parameters: Float[Array, "7"]) -> list[Float[Array, " row"]]:
        moved = _transformed(unknowns, parameters, radius)
        angles = jnp.stack(o.system.angles_from_rotation(tuple(moved.rotation[:, held])))
        exterior = jnp.concatenate([moved.centre[:, held] / radius, angles])
        rows = [moved.points[:, fixed] * ~o.point_free[:, fixed] / radius, exterior * ~o.exterior_free[:, held]]
        rows += [group_residuals(moved, group) * (group.weights > 0) / radius for group in o.groups]
        return [row.ravel() for row in rows]

    return jnp.concatenate(jax.jacfwd(carried)(jnp.zeros(7)))


_compiled_rows = Compiled(_datum_rows)


def _padded_indices(mask: Bool[np.ndarray, " entity"]) -> Int[Array, " padded"]:
    """Where the mask is true; the first entity, which counts nothing if it is free, fills up."""
    index = np.nonzero(mask)[0]
    padded = np.full(grid_size(len(index)), np.argmin(mask))
    padded[: len(index)] = index
    return on_device(padded, jnp.int32)


def _axis(direction: Float[np.ndarray, "3"]) -> str:
    direction = direction / np.linalg.norm(direction)
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) > 0.999:
        return "XYZ"[k]
    return "({:.2f}, {:.2f}, {:.2f})".format(*np.round(direction * np.sign(direction[k]), 2) + 0.0)


def _null_space(matrix: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "column defect"]:
    _, singular, vt = np.linalg.svd(np.concatenate([matrix, np.zeros((7, matrix.shape[1]))]), full_matrices=False)
    return vt[singular <= RANK_TOLERANCE].T


def datum_defect(block: Block) -> DatumDefect:
    """What the control, the observed stations, the distances and the held elements leave undetermined."""
    structure = block.structure
    fixed, held = (~structure.point_free).sum(1) > 0, (~structure.exterior_free).sum(1) > 0
    if not (fixed.any() or held.any() or block.groups):
        return DatumDefect(7, "origin, axes and scale")
    centred = block.moved(-np.mean(np.asarray(block.object_points), 0))
    rows = _compiled_rows(
        unknowns_of(centred), observations_of(centred), _padded_indices(fixed), _padded_indices(held), optimised=False
    )
    free = _null_space(np.asarray(rows))
    return DatumDefect(free.shape[1], _words(free))


def _words(free: Float[np.ndarray, "7 defect"]) -> str:
    """The undetermined parameters in words."""
    if free.shape[1] in (0, 7):
        return "origin, axes and scale" if free.shape[1] else ""
    words = []
    shifts = free @ _null_space(free[3:])  # combinations without rotation and scale
    if shifts.shape[1] == 3:
        words.append("the origin")
    else:
        words += [f"the position along {_axis(shift[:3])}" for shift in shifts.T]
    rest = free - shifts @ (shifts.T @ free)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    remaining = left[:, size > RANK_TOLERANCE]
    turns, size, _ = np.linalg.svd(remaining[3:6], full_matrices=False)
    turns = turns[:, : int((size > RANK_TOLERANCE).sum())]
    if turns.shape[1] == 1:
        words.append(f"the rotation about an axis parallel to {_axis(turns[:, 0])}")
    elif turns.shape[1]:
        words.append("all three rotations" if turns.shape[1] == 3 else "two of the three rotations")
    if remaining.shape[1] > turns.shape[1]:
        words.append("the scale")
    return ", ".join(words)


def is_located(block: Block) -> bool:
    """Whether any coordinate of the object system is observed or held."""
    structure = block.structure
    return bool(
        (~structure.point_free).any()
        or structure.datum.held
        or any(group.structure.kind.in_object_system and group.count for group in block.groups)
    )


def with_datum(block: Block) -> Block:
    """The block with its datum defined: by control, as held by the user, or by a minimal set chosen here.

    The minimal datum holds all six elements of the first image and, unless a distance gives the scale, that coordinate
    of another image which differs most from the first one's.

    Raises: BlockError where control exists but leaves a part of the datum undetermined.
    """
    structure = block.structure
    if structure.datum.kind in ("control", "minimal"):
        return block
    if not block.concrete:
        raise ValueError(
            "the datum is chosen before tracing: call block = jaxbundle.with_datum(block) outside of jit, grad and vmap"
        )
    defect = datum_defect(block)
    if defect.count == 0:
        kind = structure.datum.kind if structure.datum.held else "control"
        return _with_structure(block, datum=Datum(kind, structure.datum.held))
    if is_located(block):
        raise BlockError([insufficient(defect)])
    free = structure.exterior_free.copy()
    first = structure.image_names[0]
    free[0] = False
    held = [(first, element) for element in structure.exterior_elements]
    if defect.count == 7:
        centres = np.asarray(block.exterior.projection_centre)
        image, k = np.unravel_index(np.argmax(np.abs(centres - centres[0])), centres.shape)
        free[image, k] = False
        held.append((structure.image_names[image], structure.exterior_elements[k]))
    return _with_structure(block, datum=Datum("minimal", tuple(held)), exterior_free=free)


def insufficient(defect: DatumDefect) -> Problem:
    """The problem of a datum that control determines in part."""
    return Problem(
        f"the control leaves {defect.count} of the 7 parameters of the datum undetermined: {defect.words}",
        "a block needs at least two points with X, Y, Z and a third one with Z that is not on a line with them,"
        " or observed stations that are not on one line",
        "control",
    )


def _with_structure(block: Block, **changes: object) -> Block:
    structure = dataclasses.replace(block.structure, **changes)
    return Block(
        structure, block.exterior, block.interior, block.object_points, block.rays, block.groups, block.check_points
    )
