"""Replacing values of a block by name; values may be tracers of jit, grad and vmap."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbundle.block.named import UnknownNameError
from jaxbundle.block.observation_kinds import ObservationGroup

B = TypeVar("B", bound=eqx.Module)
NAMED = {"point": "point_names", "image": "image_names"}  # entities whose names identify a row


def with_arrays(block: B, arrays: Mapping[str, Any]) -> B:
    """The block with other arrays, given as paths such as "rays.coordinates" with new values of the same shapes."""
    for path, new in arrays.items():
        if new is None:
            continue

        def leaf(b: Any, path: str = path) -> Any:
            for part in path.split("."):
                b = getattr(b, part)
            return b

        block = eqx.tree_at(leaf, block, _of_shape(new, leaf(block), path))
    return block


def with_points(block: Any, points: Any) -> Any:
    """The block with other object points: an array, or coordinates by name."""
    if not isinstance(points, Mapping):
        return with_arrays(block, {"object_points": points})
    return with_arrays(block, {"object_points": _by_name(block.object_points, points, block.structure.point_names)})


def with_interior(block: Any, interior: Any) -> Any:
    """The block with other interior elements: an array, or for each camera its elements by name."""
    if not isinstance(interior, Mapping):
        return with_arrays(block, {"interior.elements": interior})
    elements, cameras = jnp.asarray(block.interior.elements), block.structure.cameras
    names = [camera.name for camera in cameras]
    for name, values in interior.items():
        if name not in names:
            raise UnknownNameError("camera", name, names)
        row = names.index(name)
        known = cameras[row].model.elements
        for element, value in values.items():
            if element not in known:
                raise UnknownNameError(f"element of camera {name}", element, known)
            elements = elements.at[row, known.index(element)].set(value)
    return with_arrays(block, {"interior.elements": elements})


def with_observations(block: Any, table: str, values: Any) -> Any:
    """The block with other observed values of a table: an array of all its rows, or values by the name of the row.

    Control is given by the names of its points where some of its coordinates are fixed.
    """
    numbers = _groups_of(block, table, needed=table != "control")
    if isinstance(values, Mapping):
        if table == "control":
            block, values = _with_fixed(block, values)
        return _with_groups(block, {k: _named_rows(block, k, values) for k in numbers})
    if table == "control" and not (block.structure.point_free.all() and numbers):
        raise ValueError('some control coordinates are fixed: give control by name, such as {"20": (X, Y, Z)}')
    rows = np.cumsum([len(block.groups[k].values) for k in numbers])
    new = jnp.asarray(values)
    if new.shape != (rows[-1], *block.groups[numbers[0]].values.shape[1:]):
        shape = (int(rows[-1]), *block.groups[numbers[0]].values.shape[1:])
        raise ValueError(f"{table} have the shape {new.shape}, not {shape}: give one row for each row of the table")
    return _with_groups(block, dict(zip(numbers, jnp.split(new, rows[:-1]), strict=True)))


def with_sigmas(block: Any, sigmas: Mapping[str, Any]) -> Any:
    """The block with other standard deviations, by table: arrays, or one number for the whole table."""
    for table, new in sigmas.items():
        if table == "rays":
            block = with_arrays(block, {"rays.sigmas": _spread(new, block.rays.sigmas)})
            continue
        for k in _groups_of(block, table):
            old = block.groups[k]
            if old.covariances is not None:
                raise ValueError(f"{table} have covariances; build a new group to replace them")
            block = eqx.tree_at(lambda b, k=k: b.groups[k].sigmas, block, _spread(new, old.sigmas))
    return block


def _spread(new: Any, old: Any) -> Array:
    return jnp.broadcast_to(jnp.asarray(new, float), np.shape(old))


def _of_shape(new: Any, old: Any, path: str) -> Array:
    array = jnp.asarray(new)
    if array.shape != np.shape(old):
        raise ValueError(f"{path} has the shape {array.shape}, not {np.shape(old)}")
    return array


def _by_name(old: Any, new: Mapping[str, Any], names: Sequence[str]) -> Array:
    index = {name: k for k, name in enumerate(names)}
    array = jnp.asarray(old)
    for name, value in new.items():
        if name not in index:
            raise UnknownNameError("point", name, names)
        array = array.at[index[name]].set(jnp.asarray(value))
    return array


def _groups_of(block: Any, table: str, needed: bool = True) -> list[int]:
    groups: tuple[ObservationGroup, ...] = block.groups
    numbers = [k for k, group in enumerate(groups) if group.structure.kind.table == table]
    if needed and not numbers:
        known = sorted({"rays", *(group.structure.kind.table for group in groups)})
        raise ValueError(f"the block has no observations {table!r}; it has {', '.join(known)}")
    return numbers


def _with_groups(block: Any, values: Mapping[int, Array]) -> Any:
    for k, new in values.items():
        block = eqx.tree_at(lambda b, k=k: b.groups[k].values, block, new)
    return block


def _row_names(block: Any, number: int) -> list[str]:
    structure = block.groups[number].structure
    names = getattr(block.structure, NAMED.get(structure.kind.touches[0], ""), None)
    if names is None:
        raise ValueError(f"rows of {structure.kind.table} have no names; give an array of all of them")
    return [names[k] for k in structure.indices[:, 0].tolist()]


def _named_rows(block: Any, number: int, values: Mapping[str, Any]) -> Array:
    names, new = _row_names(block, number), jnp.asarray(block.groups[number].values)
    table = block.groups[number].structure.kind.table
    known = {name for k in _groups_of(block, table) for name in _row_names(block, k)}
    for name, value in values.items():
        if name not in known:
            raise UnknownNameError(f"row of {table}:", name, sorted(known))
        if name in names:
            new = new.at[names.index(name)].set(jnp.asarray(value))
    return new


def _with_fixed(block: Any, control: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The block with other fixed coordinates, and the control points that are also observed."""
    s = block.structure
    observed = {name for k in _groups_of(block, "control", needed=False) for name in _row_names(block, k)}
    index = {name: k for k, name in enumerate(s.point_names)}
    points = jnp.asarray(block.object_points)
    known = sorted({*observed, *(s.point_names[k] for k in np.flatnonzero(~s.point_free.all(1)))})
    for name, value in control.items():
        if name not in known:
            raise UnknownNameError("control point", name, known)
        fixed = ~s.point_free[index[name]]
        points = points.at[index[name]].set(jnp.where(fixed, jnp.asarray(value, float), points[index[name]]))
    block = eqx.tree_at(lambda b: b.object_points, block, points)
    return block, {name: value for name, value in control.items() if name in observed}
