"""Writing a block, approximate or adjusted, as a block folder; reading it again gives the same block."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import CENTRE_ELEMENTS, Block, Camera, Structure
from jaxbundle.block.given import require_a
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, PARAMETERS, STATIONS, ObservationKind, interior_priors
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.wording import RADIANS
from jaxbundle.camera.camera_models import CAMERA_MODELS, named_model
from jaxbundle.camera.model import CORRECTIONS
from jaxbundle.io.block_tables import COORDINATES, TABLES, table_of_kind
from jaxbundle.io.block_toml import FILE, write_block_toml
from jaxbundle.io.known_tables import COVARIANCES, PLACES
from jaxbundle.io.navigation_tables import navigation_columns, navigation_problems, navigation_sections
from jaxbundle.io.observation_writer import (
    Prior,
    observation_columns,
    observation_problems,
    owner_names,
    priors_of,
)
from jaxbundle.io.settings import Settings, coefficient_names
from jaxbundle.io.tables import Columns, write_table


def write_block_folder(block: Block, path: str | Path) -> None:
    """Writes block.toml and the tables; a missing folder is created.

    Rays that were transformed to mm by fiducials are written in mm; corrections are written as their coefficients. An
    observed parameter or interior element is written with its observed value, which then is its approximate value.

    Raises: BlockError where the block has a camera model or a kind of observation that format 1 does not have.

    Example:
        >>> jb.write_block_folder(result.block, "adjusted")
        >>> len(jb.read("adjusted").points)
        8
    """
    require_a(Block, block, "write_block_folder")
    _require_writable(block)
    tables = {"images": _images(block), "rays": _rays(block), "points": _points(block)}
    tables |= {"control": _control(block), **navigation_columns(block), **observation_columns(block)}
    tables = {kind: tables[kind] for kind in TABLES if kind in tables and len(next(iter(tables[kind].values())))}
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    for kind, columns in tables.items():
        write_table(folder / f"{kind}.csv", columns)
    write_block_toml(folder / FILE, _settings(block, {kind: f"{kind}.csv" for kind in tables}))


def _require_writable(block: Block) -> None:
    system = block.structure.rotation_system.name
    known = {
        CONTROL,
        STATIONS,
        GNSS_STATIONS,
        ATTITUDES[system],
        PARAMETERS,
        *table_of_kind(),
        *_interior_kinds(block),
    }
    kinds = [group.structure.kind for group in block.groups]
    problems = [
        Problem(f"observations of kind '{kind.name}' have no table in a block folder", "leave them out", kind.table)
        for kind in kinds
        if kind not in known
    ]
    problems += [
        Problem(f"there are several groups of kind '{kind.name}'", "make one group of them", kind.table)
        for kind in dict.fromkeys(kinds)
        if kinds.count(kind) > 1 and kind in known
    ]
    problems += [*observation_problems(block), *navigation_problems(block), *_lost(block), *_held_and_observed(block)]
    problems += [
        Problem(f"camera {camera.name} has the model '{camera.model.name}'", f"known: {', '.join(CAMERA_MODELS)}")
        for camera in block.structure.cameras
        if named_model(camera.model) is None
    ]
    if problems:
        raise BlockError(problems)


def _interior_kinds(block: Block) -> list[ObservationKind]:
    """Observed interior elements: each member observes one element of one camera."""
    return [interior_priors(camera.model.elements) for camera in block.structure.cameras]


def _lost(block: Block) -> list[Problem]:
    """Problems of parameters that belong to no table."""
    known = {GNSS_STATIONS, *ATTITUDES.values(), *table_of_kind()}
    structures = [group.structure for group in block.groups if group.structure.kind in known]
    used = {
        int(p)
        for structure in structures
        for k, touched in enumerate(structure.kind.touches)
        if touched == "parameter"
        for p in structure.indices[:, k]
    }
    observed = [int(p) for g in block.groups if g.structure.kind == PARAMETERS for p in g.structure.indices[:, 0]]
    lost = [p for p in range(len(block.structure.parameters)) if p not in used or observed.count(p) > 1]
    return [
        Problem(
            f"parameter {block.structure.parameters[p].name} "
            + ("is observed several times" if p in used else "belongs to no observation of a block folder"),
            "leave it out",
            "parameters",
        )
        for p in lost
    ]


def _held_and_observed(block: Block) -> list[Problem]:
    """Problems of interior elements and bar lengths that are fixed and observed at the same time."""
    names = [
        f"{element} of camera {block.structure.cameras[c].name}"
        for c, known in _interior_priors(block).items()
        for k, element in enumerate(block.structure.cameras[c].model.elements)
        if element in known and not block.structure.interior_free[c, k]
    ]
    lengths = [p for p in owner_names(block, "scale_bars") if p in priors_of(block)]
    names += [p.name for p in (block.structure.parameters[k] for k in lengths) if not p.free]
    return [Problem(f"{name} is both observed and fixed", "make it unknown", "parameters") for name in names]


def _interior_priors(block: Block) -> dict[int, dict[str, Prior]]:
    """Observed interior elements of each camera."""
    kinds, priors = _interior_kinds(block), {}
    for group in (group for group in block.groups if group.structure.kind in kinds):
        structure, values, sigmas = group.structure, np.asarray(group.values), np.asarray(group.sigmas)
        for row, k in np.argwhere(structure.observed).tolist():
            prior = Prior(float(values[row, k]), float(sigmas[row, k]))
            priors.setdefault(int(structure.indices[row, 0]), {})[structure.kind.components[k]] = prior
    return priors


def _settings(block: Block, tables: dict[str, str]) -> Settings:
    structure = block.structure
    interior, priors = np.asarray(block.interior.elements), _interior_priors(block)
    cameras = {
        camera.name: _camera(camera, interior[k], structure.interior_free[k], priors.get(k, {}))
        for k, camera in enumerate(structure.cameras)
    }
    settings: dict[str, Any] = {
        "format": 1,
        "name": structure.name,
        "source": structure.source,
        "units": {"object": structure.object_unit, "angle": structure.angle_unit},
        "rotation": {"system": structure.rotation_system.name},
        "cameras": cameras,
        "navigation": navigation_sections(block) or None,
        "sigma": {"image": _usual_sigma(block)},
        "tables": tables,
    }
    hold = _held(structure)
    if structure.datum.kind == "inner":
        settings["datum"] = {"type": "inner", "points": list(structure.datum.points) or None}
    elif hold:
        settings["datum"] = {"type": "minimal" if structure.datum.kind == "minimal" else "fixed", "hold": hold}
    return Settings.model_validate(settings)


def _camera(
    camera: Camera, interior: Float[np.ndarray, " element"], free: np.ndarray, priors: dict[str, Prior]
) -> dict[str, Any]:
    elements = dict(zip(camera.model.elements, interior.tolist(), strict=False))
    elements |= {name: prior.value for name, prior in priors.items()}
    model = named_model(camera.model) or camera.model
    section: dict[str, Any] = {
        "image_unit": camera.image_unit,
        "pixel_size": elements["pixel_size"] if camera.principal_distance_in_mm else None,
        "width": camera.width,
        "height": camera.height,
        "principal_distance": elements["principal_distance"],
        "principal_point": [elements["x0"], elements["y0"]] if "x0" in elements else None,
        "distortion": model.name,
        "estimate": [name for name, unknown in zip(camera.model.elements, free, strict=False) if unknown],
        "priors": {name: prior.sigma for name, prior in priors.items()} or None,
    }
    coefficients = {name: elements[name] for name in coefficient_names(model)}
    corrections = {name: elements[name] for name in CORRECTIONS if name in elements}
    return {**section, "coefficients": coefficients, "corrections": corrections or None}


def _held(structure: Structure) -> dict[str, list[str]]:
    """Fixed elements of each image, the images in the order of the datum's list."""
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
    """The most frequent standard deviation of the image coordinates."""
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


def _weighted_control(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Points, observed coordinates and their sigmas, NaN where a coordinate is not observed; covariances."""
    for group in block.groups:
        if group.structure.kind == CONTROL:
            observed, sigmas = group.structure.observed, np.asarray(group.sigmas)
            covariances = group.covariances
            if covariances is not None:
                covariances = np.asarray(covariances)
                variances = np.diagonal(covariances, axis1=1, axis2=2)
                sigmas = np.where(sigmas**2 == variances, sigmas, np.sqrt(variances))
            values, sigmas = (np.where(observed, array, np.nan) for array in (np.asarray(group.values), sigmas))
            return group.structure.indices[:, 0], values, sigmas, covariances
    return np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3)), None


def _control(block: Block) -> Columns:
    """Weighted control first, then fixed control, then check points."""
    structure = block.structure
    weighted, values, sigmas, covariances = _weighted_control(block)
    held = np.flatnonzero(~structure.point_free.all(1))
    points = np.concatenate([weighted, held[~np.isin(held, weighted)]])
    empty = np.full((len(points) - len(weighted), 3), np.nan)
    fixed = ~structure.point_free[points]
    values = np.where(fixed, np.asarray(block.object_points)[points], np.concatenate([values, empty]))
    sigmas = np.where(fixed, 0.0, np.concatenate([sigmas, empty]))
    check = block.check_points
    together: Columns = {}
    if covariances is not None:
        both = sigmas[: len(weighted)] > 0
        others = np.full(len(points) + len(structure.check_point) - len(weighted), np.nan)
        for (a, b), column in zip(PLACES, COVARIANCES, strict=True):
            given = np.where(both[:, a] & both[:, b], covariances[:, a, b], np.nan)
            together[column] = np.concatenate([given, others])
    return {
        "point": _named(structure.point_names, np.concatenate([points, structure.check_point])),
        **_coordinates(COORDINATES, np.concatenate([values, check.coordinates])),
        **_coordinates(("sX", "sY", "sZ"), np.concatenate([sigmas, check.sigmas])),
        "role": ["control"] * len(points) + ["check"] * len(structure.check_point),
        **together,
    }
