"""A block, approximate or adjusted, written as a block folder; reading it back gives the same block."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import CENTRE_ELEMENTS, Block, Camera, Structure
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observations import CONTROL, STATIONS
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.camera.model import CORRECTIONS
from jaxbundle.camera.registry import CAMERA_MODELS, named_model
from jaxbundle.io.block_folder import RADIANS
from jaxbundle.io.block_toml import FILE, write_block_toml
from jaxbundle.io.folder_tables import COORDINATES, SIGMAS
from jaxbundle.io.settings import Settings, coefficient_names
from jaxbundle.io.tables import Columns, write_table


def write_block_folder(block: Block, path: str | Path) -> None:
    """Writes block.toml and the tables; the folder is made where it does not exist.

    Rays that fiducials brought to mm are written in mm; corrections are written as their coefficients.

    Raises: BlockError where the block has a camera model or a kind of observation that has no place in format 1.
    """
    _require_writable(block)
    tables = {"images": _images(block), "rays": _rays(block), "points": _points(block)}
    tables |= {"control": _control(block), "stations": _stations(block), "distances": _distances(block)}
    tables = {kind: columns for kind, columns in tables.items() if len(next(iter(columns.values())))}
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    for kind, columns in tables.items():
        write_table(folder / f"{kind}.csv", columns)
    write_block_toml(folder / FILE, _settings(block, {kind: f"{kind}.csv" for kind in tables}))


def _require_writable(block: Block) -> None:
    known = (CONTROL, STATIONS, DISTANCES)
    kinds = [group.structure.kind for group in block.groups]
    problems = [
        Problem(f"observations of kind '{kind.name}' have no table in a block folder", "leave them out", kind.name)
        for kind in kinds
        if kind not in known
    ]
    problems += [
        Problem(f"there are several groups of kind '{kind.name}'", "make one group of them", kind.name)
        for kind in known
        if kinds.count(kind) > 1
    ]
    problems += [
        Problem(f"camera {camera.name} has the model '{camera.model.name}'", f"known: {', '.join(CAMERA_MODELS)}")
        for camera in block.structure.cameras
        if named_model(camera.model) is None
    ]
    if problems:
        raise BlockError(problems)


def _settings(block: Block, tables: dict[str, str]) -> Settings:
    structure = block.structure
    interior = np.asarray(block.interior.elements)
    cameras = {
        camera.name: _camera(camera, interior[k], structure.interior_free[k])
        for k, camera in enumerate(structure.cameras)
    }
    settings: dict[str, Any] = {
        "format": 1,
        "name": structure.name,
        "source": structure.source,
        "units": {"object": structure.object_unit, "angle": structure.angle_unit},
        "rotation": {"system": structure.rotation_system.name},
        "cameras": cameras,
        "sigma": {"image": _usual_sigma(block)},
        "tables": tables,
    }
    hold = _held(structure)
    if hold:
        settings["datum"] = {"type": "minimal" if structure.datum.kind == "minimal" else "fixed", "hold": hold}
    return Settings.model_validate(settings)


def _camera(camera: Camera, interior: Float[np.ndarray, " element"], free: np.ndarray) -> dict[str, Any]:
    elements = dict(zip(camera.model.elements, interior.tolist(), strict=False))
    model = named_model(camera.model) or camera.model
    section: dict[str, Any] = {
        "image_unit": camera.image_unit,
        "pixel_size": elements["pixel_size"] if camera.metric else None,
        "width": camera.width,
        "height": camera.height,
        "principal_distance": elements["principal_distance"],
        "principal_point": [elements["x0"], elements["y0"]] if "x0" in elements else None,
        "distortion": model.name,
        "estimate": [name for name, unknown in zip(camera.model.elements, free, strict=False) if unknown],
    }
    coefficients = {name: elements[name] for name in coefficient_names(model)}
    corrections = {name: elements[name] for name in CORRECTIONS if name in elements}
    return {**section, "coefficients": coefficients, "corrections": corrections or None}


def _held(structure: Structure) -> dict[str, list[str]]:
    """Held elements by image, the images in the order of the datum's own list."""
    order = dict.fromkeys(image for image, _ in structure.datum.held)
    held = {
        structure.image_names[i]: [structure.exterior_elements[k] for k in np.flatnonzero(~structure.exterior_free[i])]
        for i in np.flatnonzero(~structure.exterior_free.all(1))
    }
    return {image: held[image] for image in (*order, *(name for name in held if name not in order)) if image in held}


def _named(names: tuple[str, ...], index: np.ndarray) -> list[str]:
    return [names[i] for i in index]


def _coordinates(columns: tuple[str, ...], values: Float[np.ndarray, "row component"]) -> Columns:
    return dict(zip(columns, np.asarray(values).T, strict=True))


def _images(block: Block) -> Columns:
    structure = block.structure
    angles = np.asarray(block.exterior.angles) / RADIANS[structure.angle_unit]
    return {
        "image": list(structure.image_names),
        "camera": [structure.cameras[k].name for k in structure.image_camera],
        **_coordinates(CENTRE_ELEMENTS, np.asarray(block.exterior.projection_centre)),
        **_coordinates(structure.rotation_system.angles, angles),
    }


def _usual_sigma(block: Block) -> float:
    """The standard deviation that most image coordinates have."""
    values, counts = np.unique(np.asarray(block.rays.sigmas), return_counts=True)
    return float(values[np.argmax(counts)])


def _rays(block: Block) -> Columns:
    structure = block.structure
    sigmas = np.asarray(block.rays.sigmas)
    return {
        "image": _named(structure.image_names, structure.ray_image),
        "point": _named(structure.point_names, structure.ray_point),
        **_coordinates(("x", "y"), np.asarray(block.rays.coordinates)),
        **_coordinates(("sx", "sy"), np.where(sigmas == _usual_sigma(block), np.nan, sigmas)),
    }


def _points(block: Block) -> Columns:
    return {
        "point": list(block.structure.point_names),
        **_coordinates(COORDINATES, np.asarray(block.object_points)),
    }


def _observed(block: Block, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices, values and sigmas of a kind of observation; NaN where a component is not observed."""
    for group in block.groups:
        if group.structure.kind.name == name:
            observed = group.structure.observed
            values, sigmas = (np.where(observed, array, np.nan) for array in (group.values, group.sigmas))
            return group.structure.indices, values, sigmas
    return np.zeros((0, 2), int), np.zeros((0, 3)), np.zeros((0, 3))


def _control(block: Block) -> Columns:
    """Weighted control first, then control that is held, then check points."""
    structure = block.structure
    weighted, values, sigmas = _observed(block, CONTROL.name)
    held = np.flatnonzero(~structure.point_free.all(1))
    points = np.concatenate([weighted[:, 0], held[~np.isin(held, weighted[:, 0])]])
    empty = np.full((len(points) - len(weighted), 3), np.nan)
    fixed = ~structure.point_free[points]
    values = np.where(fixed, np.asarray(block.object_points)[points], np.concatenate([values, empty]))
    sigmas = np.where(fixed, 0.0, np.concatenate([sigmas, empty]))
    check = block.check_points
    return {
        "point": _named(structure.point_names, np.concatenate([points, structure.check_point])),
        **_coordinates(COORDINATES, np.concatenate([values, check.coordinates])),
        **_coordinates(SIGMAS, np.concatenate([sigmas, check.sigmas])),
        "role": ["control"] * len(points) + ["check"] * len(structure.check_point),
    }


def _stations(block: Block) -> Columns:
    images, values, sigmas = _observed(block, STATIONS.name)
    names = _named(block.structure.image_names, images[:, 0])
    return {"image": names, **_coordinates(COORDINATES, values), **_coordinates(SIGMAS, sigmas)}


def _distances(block: Block) -> Columns:
    points, values, sigmas = _observed(block, DISTANCES.name)
    names = block.structure.point_names
    return {
        "from": _named(names, points[:, 0]),
        "to": _named(names, points[:, 1]),
        "distance": values[:, 0],
        "sigma": sigmas[:, 0],
    }
