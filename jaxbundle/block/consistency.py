"""Checking the consistency of a block: types, shapes, index ranges, names and functions; all problems at once.

These problems make all other checks meaningless, so these checks come first.
"""

from collections.abc import Iterator, Sequence
from typing import Any
from weakref import WeakSet

import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block, Camera, Datum, Parameter, Structure
from jaxbundle.block.observation_kinds import GroupStructure, ObservationGroup, ObservationKind, kind_defect
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.camera.model import HELD, CameraModel, model_defect
from jaxbundle.geometry.rotation import RotationSystem

DATUMS = ("control", "fixed", "minimal", "inner", "open")
ANGLE_UNITS, IMAGE_UNITS = ("deg", "gon", "rad"), ("px", "mm")
ENTITIES = ("image", "point", "camera", "parameter")
NUMBERS = {
    "integer": (np.integer, "integers"),
    "bool": (np.bool_, "True and False"),
    "float": (np.floating, "floating-point numbers"),
}


# structures that were already checked; their arrays are read-only
_CONSISTENT: "WeakSet[Structure]" = WeakSet()


def require_consistent(block: Block) -> None:
    """Raises BlockError with all inconsistencies between the parts of a block."""
    problems = inconsistencies(block)
    if problems:
        raise BlockError(problems)


def inconsistencies(block: Block) -> list[Problem]:
    """Inconsistencies of a block; the values of its arrays are not used and may be traced."""
    structure = block.structure
    if not isinstance(structure, Structure):
        return [Problem(f"the structure is {_type(structure)}, not a Structure", "build a jb.blocks.Structure")]
    known = structure in _CONSISTENT
    names = [] if known else [*_names(structure)] or [*_descriptions(structure)] or [*_models(structure)]
    if names:
        return names  # without names and models the counts are unknown
    found = [] if known else [*_incidences(structure), *_masks(structure)]
    found += [*_values(block), *_groups(block)]
    found = found or [*_interior(block), *_datum(structure)]
    if not found:
        _CONSISTENT.add(structure)
    return found


def _counts(s: Structure) -> dict[str, int]:
    counts = len(s.image_names), len(s.point_names), len(s.cameras), len(s.parameters)
    return dict(zip(ENTITIES, counts, strict=True))


def _type(value: Any) -> str:
    return "None" if value is None else f"of type {type(value).__name__}"


def _names(s: Structure) -> Iterator[Problem]:
    """Problems of names and cameras: their types, and repeated names."""
    for table, values, kind in (
        ("images", s.image_names, str),
        ("points", s.point_names, str),
        ("cameras", s.cameras, Camera),
        ("parameters", s.parameters, Parameter),
    ):
        if not isinstance(values, tuple) or not all(isinstance(value, kind) for value in values):
            yield Problem(f"the {table} are {_type(values)}", f"give a tuple of {kind.__name__}", table)
            continue
        if not values and table in ("images", "cameras"):
            yield Problem(f"there are no {table}", "give at least one", table)
        names: tuple[Any, ...] = values if kind is str else tuple(getattr(value, "name", "") for value in values)
        if not all(isinstance(name, str) for name in names):
            yield Problem(f"a name among the {table} is not a string", "give names as strings", table)
            continue
        if len(set(names)) < len(names):
            seen: set[str] = set()
            twice = next(name for name in names if name in seen or seen.add(name))
            more = len(names) - len(set(names))
            yield Problem(
                f"the name {twice!r} is given twice, {more} of {len(names)} names repeat others",
                "give each one a different name",
                table,
            )


def _descriptions(s: Structure) -> Iterator[Problem]:
    """Problems of the descriptions of the block and its cameras."""
    for what, value, allowed in (
        ("angle_unit", s.angle_unit, ANGLE_UNITS),
        *((f"image_unit of camera {camera.name}", camera.image_unit, IMAGE_UNITS) for camera in s.cameras),
    ):
        if not isinstance(value, str) or value not in allowed:
            given = repr(value) if isinstance(value, str) else _type(value)
            yield Problem(f"{what} is {given}", f"give one of {', '.join(allowed)}")
    for what, value, kind in (
        ("name", s.name, str),
        ("object_unit", s.object_unit, str),
        ("rotation_system", s.rotation_system, RotationSystem),
        ("datum", s.datum, Datum),
        ("findings", s.findings, tuple),
        ("inner_orientations", s.inner_orientations, tuple),
        *((f"width of camera {camera.name}", camera.width, int | None) for camera in s.cameras),
        *((f"height of camera {camera.name}", camera.height, int | None) for camera in s.cameras),
        *(
            (f"principal_distance_in_mm of camera {camera.name}", camera.principal_distance_in_mm, bool)
            for camera in s.cameras
        ),
    ):
        if not isinstance(value, kind):
            wanted = getattr(kind, "__name__", "number of px, or None")
            yield Problem(f"{what} is {_type(value)}", f"give a {wanted}")


def _array_problem(what: str, value: Any, shape: tuple[int, ...], wanted: str, axes: str) -> Problem | None:
    """Problems of an array of `wanted` numbers: "float", "integer" or "bool"; `axes` explains its shape."""
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        return Problem(f"{what} is {_type(value)}, not an array", f"give an array of shape {shape}, {axes}")
    if tuple(value.shape) != shape:
        return Problem(f"{what} has the shape {tuple(value.shape)}", f"give an array of shape {shape}, {axes}")
    kind, numbers = NUMBERS[wanted]
    if not jnp.issubdtype(value.dtype, kind):
        return Problem(f"{what} is an array of {value.dtype}", f"give an array of {numbers}")
    # a host array is converted to the precision in use, an array of JAX has its own precision
    if wanted == "float" and jnp.finfo(value.dtype).bits < jnp.finfo(jnp.result_type(float)).bits:
        return Problem(f"{what} is an array of {value.dtype}, too coarse for an adjustment", "give float64")
    return None


def _index_problems(what: str, index: Any, size: int, table: str, of: str) -> list[Problem]:
    """Indices outside a table, as one problem; `what`: words for row {}, `of`: words for a row of the table."""
    if not isinstance(index, np.ndarray):
        return [Problem(f"the indices of {of}s are {_type(index)}", "give a numpy array: indices are static", table)]
    wrong = np.flatnonzero((index < 0) | (index >= size))
    if len(wrong) == 0:
        return []
    row = int(wrong[0])
    more = f", and {len(wrong) - 1} more similar ones" if len(wrong) > 1 else ""
    there = "are" if size != 1 else "is"
    return [
        Problem(
            f"{what.format(row)} names {of} {index[row]}, there {there} {size} {of}{'s' if size != 1 else ''}{more}",
            f"number the {of}s from 0" + (f" to {size - 1}" if size else ""),
            table,
            row,
        )
    ]


def _indices(what: str, value: Any, rows: int | None, size: int, table: str, of: str) -> Iterator[Problem]:
    """Problems of an array of indices: its shape, its type and its range."""
    rows = len(value) if rows is None and getattr(value, "ndim", 0) == 1 else rows or 0
    wrong = _array_problem(f"{what} (indices of {of}s)", value, (rows,), "integer", f"one index for each {table[:-1]}")
    if wrong:
        yield wrong
    else:
        yield from _index_problems(table[:-1].replace("_", " ") + " {}", value, size, table, of)


def _incidences(s: Structure) -> Iterator[Problem]:
    """Problems of the indices of images, points and cameras."""
    images, points, cameras = len(s.image_names), len(s.point_names), len(s.cameras)
    rays = len(s.ray_image) if getattr(s.ray_image, "ndim", 0) == 1 else 0
    yield from _indices("image_camera", s.image_camera, images, cameras, "images", "camera")
    yield from _indices("ray_image", s.ray_image, rays, images, "rays", "image")
    yield from _indices("ray_point", s.ray_point, rays, points, "rays", "point")
    yield from _indices("check_point", s.check_point, None, points, "check_points", "point")


def _masks(s: Structure) -> Iterator[Problem]:
    """Problems of the masks of unknown elements."""
    elements = max(len(camera.model.elements) for camera in s.cameras)
    columns = max(elements, _columns(s.interior_free))
    for what, value, shape, axes in (
        ("exterior_free", s.exterior_free, (len(s.image_names), 6), "one row for each image"),
        ("point_free", s.point_free, (len(s.point_names), 3), "one row for each point"),
        ("interior_free", s.interior_free, (len(s.cameras), columns), "one row for each camera"),
    ):
        wrong = _array_problem(what, value, shape, "bool", axes)
        if wrong or not isinstance(value, np.ndarray):
            yield wrong or Problem(f"{what} is {_type(value)}", "give a numpy array: masks of unknowns are static")
        elif what == "interior_free":
            yield from _held_elements(s)


def _held_elements(s: Structure) -> Iterator[Problem]:
    """Problems of free interior elements that the camera does not have, or that define its unit."""
    for row, (camera, free) in enumerate(zip(s.cameras, s.interior_free, strict=True)):
        elements = camera.model.elements
        beyond = [f"number {k + 1}" for k in np.flatnonzero(free) if k >= len(elements)]
        held = [name for name, unknown in zip(elements, free, strict=False) if unknown and name in HELD]
        if beyond or held:
            yield Problem(
                f"interior element {', '.join(beyond + held)} of camera {camera.name} is free, and cannot be estimated",
                f"set interior_free to False for all but {', '.join(camera.model.estimable)}",
                "cameras",
                row,
            )


def _columns(mask: Any) -> int:
    """Number of columns of a matrix; 0 for other objects."""
    shape = getattr(mask, "shape", ())
    return shape[1] if len(shape) == 2 else 0


def _models(s: Structure) -> Iterator[Problem]:
    """Problems of the cameras' models, each model once."""
    wrong = [p for p in {id(c.model): _model_problem(c) for c in s.cameras}.values() if p]
    sensors = {} if wrong else {(c.model.numbers, c.model.components): c.name for c in s.cameras}
    if len(sensors) > 1:
        what = f"cameras {' and '.join(sensors.values())} measure different numbers of coordinates of a ray"
        wrong = [Problem(what, "adjust photographs and independent models as separate blocks", "cameras")]
    yield from wrong


def _model_problem(camera: Camera) -> Problem | None:
    """Problems of a camera's model."""
    if not isinstance(camera.model, CameraModel):
        return Problem(
            f"the model of camera {camera.name} is {_type(camera.model)}, not a CameraModel",
            'take one of jb.cameras.CAMERA_MODELS, such as CAMERA_MODELS["brown"], or build a jb.cameras.CameraModel',
            "cameras",
        )
    wrong = model_defect(camera.model)
    if not wrong:
        return None
    return Problem(
        f"the camera model {str(camera.model.name)[:40]!r} of camera {camera.name} {wrong}",
        "write residual(interior, photo_vector, measured) -> (v_x, v_y) of scalars with jax.numpy",
        "cameras",
    )


def _values(block: Block) -> Iterator[Problem]:
    """Problems of the arrays of values, compared with the counts of the structure."""
    s, n = block.structure, _counts(block.structure)
    rays, check = len(np.atleast_1d(s.ray_image)), len(np.atleast_1d(s.check_point))
    width, sensor = _columns(s.interior_free), s.cameras[0].model
    for what, path, shape, axes in (
        ("exterior.projection_centre", ("exterior", "projection_centre"), (n["image"], 3), "one row for each image"),
        ("exterior.angles", ("exterior", "angles"), (n["image"], 3), "one row for each image"),
        ("interior.elements", ("interior", "elements"), (n["camera"], width), "one row for each camera"),
        ("object_points", ("object_points",), (n["point"], 3), "one row for each point"),
        ("rays.coordinates", ("rays", "coordinates"), (rays, sensor.numbers), "one row for each ray"),
        ("rays.sigmas", ("rays", "sigmas"), (rays, sensor.components), "one row for each ray"),
        ("check_points.coordinates", ("check_points", "coordinates"), (check, 3), "one row for each check point"),
        ("check_points.sigmas", ("check_points", "sigmas"), (check, 3), "one row for each check point"),
        ("parameters", ("parameters",), (n["parameter"],), "one number for each parameter"),
    ):
        value: Any = block
        for name in path:
            value = getattr(value, name, None)
        wrong = _array_problem(what, value, shape, "float", axes)
        if wrong:
            yield wrong


def _groups(block: Block) -> Iterator[Problem]:
    """Problems of the groups of observations."""
    if not isinstance(block.groups, tuple):
        yield Problem(f"groups is {_type(block.groups)}", "give a tuple with one ObservationGroup for each kind")
        return
    for number, group in enumerate(block.groups):
        if not isinstance(group, ObservationGroup):
            yield Problem(f"group {number} is {_type(group)}", "build it with jb.observations.observation_group(...)")
        elif not isinstance(group.structure, GroupStructure):
            yield Problem(f"the structure of group {number} is {_type(group.structure)}", "give a GroupStructure")
        elif not isinstance(group.structure.kind, ObservationKind):
            yield Problem(
                f"the kind of group {number} is {_type(group.structure.kind)}",
                "take one, such as jb.observations.CONTROL, or build a jb.observations.ObservationKind",
            )
        else:
            found = [*_group_arrays(block.structure, group)]
            yield from found or _kind_problems(block.structure, group)


def _group_arrays(s: Structure, group: ObservationGroup) -> Iterator[Problem]:
    """Problems of shapes and indices of one group."""
    kind, indices = group.structure.kind, group.structure.indices
    texts = kind.components, kind.touches, kind.constants
    if not (isinstance(kind.name, str) and isinstance(kind.table, str)) or not all(map(_are_names, texts)):
        yield Problem(
            "a kind of observation has a name, components, touches or constants of a wrong type",
            "give a string as its name, and tuples of strings as components, touches and constants",
        )
        return
    unknown = [touched for touched in kind.touches if touched not in ENTITIES]
    if unknown:
        yield Problem(
            f"observations of kind {kind.name} touch {unknown[0]!r}",
            f"name entities of the block: {', '.join(ENTITIES)}",
            kind.table,
        )
        return
    members = len(indices) if getattr(indices, "ndim", 0) == 2 else 0
    parts, touched = len(kind.components), len(kind.touches)
    arrays = [
        ("indices", indices, (members, touched), "integer", f"columns {', '.join(kind.touches)}"),
        ("observed", group.structure.observed, (members, parts), "bool", f"columns {', '.join(kind.components)}"),
        ("values", group.values, (members, parts), "float", f"columns {', '.join(kind.components)}"),
        ("sigmas", group.sigmas, (members, parts), "float", f"columns {', '.join(kind.components)}"),
        ("constants", group.constants, (members, len(kind.constants)), "float", f"{len(kind.constants)} columns"),
    ]
    if group.covariances is not None:
        arrays.append(("covariances", group.covariances, (members, parts, parts), "float", "one matrix for each row"))
    wrong = [_array_problem(f"{what} of {kind.name}", value, *rest) for what, value, *rest in arrays]
    yield from (problem for problem in wrong if problem)
    if wrong[0] is None:
        for column, entity in enumerate(kind.touches):
            at = indices[:, column] if isinstance(indices, np.ndarray) else indices
            yield from _index_problems(f"row {{}} of {kind.name}", at, _counts(s)[entity], kind.table, entity)


def _are_names(names: Any) -> bool:
    return isinstance(names, tuple) and all(isinstance(name, str) for name in names)


def _kind_problems(s: Structure, group: ObservationGroup) -> Iterator[Problem]:
    """Problems of the function of a kind, with the number of interior elements of the touched camera."""
    kind = group.structure.kind
    wrong = kind_defect(kind, len(s.model.elements))
    if wrong:
        takes = ", ".join([*kind.touches, "observed", *(["constants"] if kind.constants else [])])
        yield Problem(
            f"the residual of observations of kind {kind.name!r} {wrong}",
            f"write residual({takes}) -> {len(kind.components)} residuals in a tuple, of scalars with jax.numpy",
            kind.table,
        )


def _interior(block: Block) -> Iterator[Problem]:
    """Problems of missing columns for the elements of a model."""
    have = block.interior.elements.shape[1]
    for row, camera in enumerate(block.structure.cameras):
        need = len(camera.model.elements)
        if need > have:
            yield Problem(
                f"camera {camera.name} has {have} interior elements, its model {camera.model.name} takes {need}",
                f"give {', '.join(camera.model.elements)}",
                "cameras",
                row,
            )


def _datum(s: Structure) -> Iterator[Problem]:
    """Problems of the datum and of its names."""
    kind, held, points = s.datum.kind, s.datum.held, s.datum.points
    if not isinstance(kind, str) or kind not in DATUMS:
        given = repr(kind) if isinstance(kind, str) else _type(kind)
        yield Problem(f"the kind of datum is {given}", f"take one of {', '.join(DATUMS)}", "datum")
        return
    tuples = points, held, s.datum.carriers
    if not isinstance(s.datum.constraints, int) or not all(isinstance(part, tuple) for part in tuples):
        yield Problem("the datum has parts of a wrong type", "give tuples of names, and an integer", "datum")
        return
    if not all(isinstance(pair, tuple) and len(pair) == 2 for pair in held):
        yield Problem(
            "the fixed elements of the datum are not pairs of names",
            'give pairs of names, such such as ("image", "X0")',
            "datum",
        )
        return
    yield from _unknown("point", s.datum.points, s.point_names)
    yield from _unknown("image", [image for image, _ in s.datum.held], s.image_names)
    yield from _unknown("element", [element for _, element in s.datum.held], s.exterior_elements)


def _unknown(what: str, names: Sequence[str], there: Sequence[str]) -> Iterator[Problem]:
    """Problems of names of the datum that are not in the block."""
    missing = [name for name in names if name not in there] if names else []
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        yield Problem(f"the datum names {what} {missing[0]!r}{more}, which is not in the block", "drop it", "datum")
