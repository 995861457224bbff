"""The datum defect: what of origin (3), axes (3) and scale (1) of the object system the observations leave open.

A similarity transformation with the seven small parameters (t, r, m), about the block's centre of gravity and in units
of its radius,

    X' = X + t + r x X + m X,        R' = (I + [r]) R

leaves every image point where it is. So the datum is defined exactly by those rows that do change: control
coordinates, observed stations, distances, held elements. These rows may depend on parameters p of their own too, as a
shift of the navigation data, which can undo what the transformation does to them:

    A = [dv/d(t, r, m)  dv/dp]        defect = 7 + number of p - rank A

The derivatives come from autodiff, whatever kinds of observation there are.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import Problem
from jaxbundle.block.residuals import Group, Observations, group_residuals, observations_of
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.geometry import rotation
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import grid_size

RANK_TOLERANCE = 1e-8  # singular values are of order 1 for control spread over the block
MOST_NAMED = 3


@dataclass(frozen=True)
class DatumDefect:
    """Number of undetermined datum parameters and what they are in words.

    `parameters`: those of the block's own parameters that take part; `moves`: the points that move most.
    """

    count: int
    words: str
    parameters: tuple[str, ...] = ()
    moves: tuple[str, ...] = ()


def transformed(unknowns: Unknowns, parameters: Float[Array, "7"], radius: Array) -> Unknowns:
    """The block after a small similarity transformation (first order) of a block centred at its centre of gravity."""
    t, r, m = parameters[:3], parameters[3:6], parameters[6]

    def moved(x: Float[Array, "3 any"]) -> Float[Array, "3 any"]:
        turned = jnp.stack([r[1] * x[2] - r[2] * x[1], r[2] * x[0] - r[0] * x[2], r[0] * x[1] - r[1] * x[0]])
        return x + t[:, None] * radius + turned + m * x

    turn = rotation.from_rotation_vector(r[0], r[1], r[2])
    matrix = jnp.stack(rotation.product(turn, tuple(unknowns.rotation)))
    return Unknowns(matrix, moved(unknowns.centre), unknowns.interior, unknowns.parameters, moved(unknowns.points))


@Compiled
def _datum_rows(
    unknowns: Unknowns, observations: Observations, fixed: Int[Array, " point"], held: Int[Array, " image"]
) -> Float[Array, "row column"]:
    """Derivatives of what carries the datum by the seven parameters and the block's own, in units of its radius.

    `fixed`, `held`: points and images of which an element is held; what of them is free counts nothing.
    """
    radius = jnp.sqrt(jnp.mean(jnp.sum(unknowns.points**2, 0)))
    o = observations

    def carried(changes: Float[Array, " column"]) -> list[Float[Array, " row"]]:
        moved = transformed(unknowns, changes[:7], radius)
        moved = Unknowns(moved.rotation, moved.centre, moved.interior, moved.parameters + changes[7:], moved.points)
        angles = jnp.stack(o.system.angles_from_rotation(tuple(moved.rotation[:, held])))
        exterior = jnp.concatenate([moved.centre[:, held] / radius, angles])
        rows = [moved.points[:, fixed] * ~o.point_free[:, fixed] / radius, exterior * ~o.exterior_free[:, held]]
        rows += [group_residuals(moved, group) * _is_observed(group) / radius for group in o.groups]
        return [row.ravel() for row in rows]

    return jnp.concatenate(jax.jacfwd(carried)(jnp.zeros(7 + unknowns.parameters.shape[0])))


def _is_observed(group: Group) -> Bool[Array, "component member"]:
    """Which components are observed: those with a weight of their own."""
    own = group.weights if group.weights.ndim == 2 else jnp.diagonal(group.weights).T
    return own > 0


def _padded_indices(mask: Bool[np.ndarray, " entity"]) -> Int[Array, " padded"]:
    """Where the mask is true; the first entity, which counts nothing if it is free, fills up."""
    index = np.nonzero(mask)[0]
    padded = np.full(grid_size(len(index)), np.argmin(mask))
    padded[: len(index)] = index
    return on_device(padded, np.int32)


def _axis(direction: Float[np.ndarray, "3"]) -> str:
    direction = direction / np.linalg.norm(direction)
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) > 0.999:
        return "XYZ"[k]
    return "({:.2f}, {:.2f}, {:.2f})".format(*np.round(direction * np.sign(direction[k]), 2) + 0.0)


def _null_space(matrix: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "column defect"]:
    columns = matrix.shape[1]
    _, singular, vt = np.linalg.svd(np.concatenate([matrix, np.zeros((columns, columns))]), full_matrices=False)
    return vt[singular <= RANK_TOLERANCE].T


def null_space(block: Block) -> Float[np.ndarray, "column defect"]:
    """Directions of (t, r, m) and of the block's parameters that no observation and no held element notices."""
    structure = block.structure
    fixed, held = (~structure.point_free).sum(1) > 0, (~structure.exterior_free).sum(1) > 0
    free = np.concatenate([np.ones(7, bool), structure.parameter_free])
    if not (fixed.any() or held.any() or block.groups):
        return np.eye(len(free))[:, free]
    centred = block.moved(-np.mean(np.asarray(block.object_points), 0))
    rows = np.asarray(
        _datum_rows(
            unknowns_of(centred),
            observations_of(centred),
            _padded_indices(fixed),
            _padded_indices(held),
            optimised=False,
        )
    )
    # an angle and a length count alike: what is not mere rounding is brought to the length 1
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = np.where(size > RANK_TOLERANCE * size.max(initial=0.0), rows / np.where(size > 0, size, 1.0), 0.0)
    # a parameter counts in its own unit: its column is brought to the length of those of the seven
    length = np.concatenate([np.ones(7), np.linalg.norm(rows[:, 7:], axis=0)])
    scale = np.where(free & (length > 0), 1 / np.where(length > 0, length, 1.0), 1.0)
    found = _null_space((rows * scale)[:, free])
    directions = np.zeros((len(free), found.shape[1]))
    directions[free] = found
    return directions * scale[:, None]


def datum_defect(block: Block) -> DatumDefect:
    """What the control, the observed stations, the distances and the held elements leave undetermined."""
    require_a(Block, block, "datum_defect")
    directions = null_space(block)
    names = [parameter.name for parameter in block.structure.parameters]
    taking_part = np.abs(directions[7:]).max(1, initial=0.0) > RANK_TOLERANCE
    own = tuple(name for name, part in zip(names, taking_part, strict=True) if part)
    left, size, _ = np.linalg.svd(directions[:7], full_matrices=False)
    datum = left[:, : int((size > RANK_TOLERANCE).sum())]
    words = _words(datum)
    if own and directions.shape[1] > datum.shape[1]:
        words = ", ".join([*([words] if words else []), f"{directions.shape[1] - datum.shape[1]} of the parameters"])
    moves = () if datum.shape[1] in (0, 7) else _most_moved(block, datum)
    return DatumDefect(directions.shape[1], words, own, moves)


def sensitivity(block: Block, elements: list[tuple[int, int]]) -> Float[np.ndarray, "element defect"]:
    """How elements of images, given as image and its element, change along the directions that are open.

    Coordinates in units of the block's radius, angles in radians.
    """
    directions = null_space(block)
    centred = block.moved(-np.mean(np.asarray(block.object_points), 0))
    unknowns, system = unknowns_of(centred), block.structure.rotation_system
    radius = jnp.sqrt(jnp.mean(jnp.sum(unknowns.points**2, 0)))
    images, components = np.array(elements).T

    def changed(parameters: Float[Array, "7"]) -> Float[Array, " element"]:
        moved = transformed(unknowns, parameters, radius)
        angles = jnp.stack(system.angles_from_rotation(tuple(moved.rotation)))
        return jnp.concatenate([moved.centre / radius, angles])[components, images]

    derivatives = np.asarray(jax.jacfwd(changed)(jnp.zeros(7)))
    left, size, _ = np.linalg.svd(directions[:7], full_matrices=False)
    return derivatives @ left[:, size > RANK_TOLERANCE]


def _most_moved(block: Block, datum: Float[np.ndarray, "7 defect"]) -> tuple[str, ...]:
    """The object points that the undetermined directions move most."""
    x = np.asarray(block.object_points).T - np.mean(np.asarray(block.object_points), 0)[:, None]
    x = x / np.sqrt(np.mean(np.sum(x**2, 0)))
    moved = np.zeros(x.shape[1])
    for direction in datum.T:
        t, r, m = direction[:3], direction[3:6], direction[6]
        moved += np.sum((t[:, None] + np.cross(r, x.T).T + m * x) ** 2, 0)
    return tuple(block.structure.point_names[p] for p in np.argsort(-moved, kind="stable")[:MOST_NAMED])


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


def insufficient(defect: DatumDefect) -> Problem:
    """The problem of a datum that control determines in part."""
    own = ""
    if defect.parameters:
        shown = ", ".join(defect.parameters[:MOST_NAMED]) + (" ..." if len(defect.parameters) > MOST_NAMED else "")
        own = f"; parameters that take part: {shown}"
    moves = f"; points that would move most: {', '.join(defect.moves)}" if defect.moves else ""
    cure = (
        "a block needs at least two points with X, Y, Z and a third one with Z that is not on a line with them,"
        " or observed stations that are not on one line"
    )
    if defect.parameters:
        cure += "; hold the parameters or give them a value with a sigma, or add control"
    return Problem(
        f"the control leaves {defect.count} of the {7 if not defect.parameters else 'datum and navigation'} parameters"
        f"{' of the datum' if not defect.parameters else ''} undetermined: {defect.words}{own}{moves}",
        cure,
        "control",
    )
