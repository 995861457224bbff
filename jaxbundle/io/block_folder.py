"""The block folder, format 1: block.toml and tables, read to a block.

Everything that is wrong in the whole folder is told at once, with file, line and cure.
"""

import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.approximate.intersection import intersect
from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observations import (
    CONTROL,
    STATIONS,
    ObservationGroup,
    ObservationKind,
    observation_group,
)
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.validate import validate, weaknesses
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_toml import FILE, BlockToml, read_block_toml
from jaxbundle.io.fiducial_tables import with_inner_orientations
from jaxbundle.io.findings import Finding, Findings
from jaxbundle.io.folder_tables import USUAL_FILES, FolderTables, ImageRows, KnownRows, RayRows, read_folder_tables
from jaxbundle.io.settings import CameraSection, Settings
from jaxbundle.io.tables import listed

RADIANS = {"deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0}


def read_block_folder(path: str | Path) -> Block:
    """The block of a folder; points without approximate coordinates are intersected.

    Raises: BlockError with all that is wrong.
    """
    folder, findings = Path(path), Findings()
    if not folder.is_dir():
        raise BlockError([Problem(f"{folder} is no folder", f"give the path of a folder with {FILE}")])
    toml = read_block_toml(folder / FILE, findings)
    tables = read_folder_tables(folder, toml, findings)
    if tables is not None:
        tables = with_inner_orientations(tables, toml, findings)
    if toml.settings is None or tables is None:
        raise findings.error()
    block = _block(folder, toml, toml.settings, tables, findings)
    if findings:
        problems = [p for p in weaknesses(block) if findings.touched.isdisjoint(_names(block.structure, p))]
    else:
        block = intersect(block)
        problems = validate(block)
    findings.found += [Finding(*_place(problem, block, toml, tables), problem) for problem in problems]
    if findings:
        raise findings.error()
    return block


def _block(folder: Path, toml: BlockToml, settings: Settings, tables: FolderTables, findings: Findings) -> Block:
    """The block; where something was found it lacks the rows that refer to nothing known."""
    images, rays, known = tables.images, tables.rays, tables.known
    used = {name: section for name, section in settings.cameras.items() if name in images.camera}
    elements, interior_free = _interior(list(used.values()))
    datum, exterior_free = _datum(toml, settings, images, findings)
    points, point_free = _object_points(rays, known)
    check, check_points = _check_points(known.get("control"))
    structure = Structure(
        name=settings.name or folder.resolve().name,
        cameras=tuple(_camera(name, section) for name, section in used.items()),
        image_names=images.names,
        point_names=rays.points,
        image_camera=np.array([list(used).index(name) if name in used else 0 for name in images.camera], np.int32),
        ray_image=rays.image.astype(np.int32),
        ray_point=rays.point.astype(np.int32),
        exterior_free=exterior_free,
        interior_free=interior_free,
        point_free=point_free,
        check_point=check,
        datum=datum,
        rotation_system=ROTATION_SYSTEMS[settings.rotation.system],
        object_unit=settings.units.object,
        angle_unit=settings.units.angle,
        source=settings.source,
        notes=_notes(folder, toml, settings, tables),
        inner_orientations=tables.inner_orientations,
    )
    return Block(
        structure,
        ExteriorOrientation(jnp.asarray(images.centre), jnp.asarray(images.angles * RADIANS[settings.units.angle])),
        InteriorOrientation(jnp.asarray(elements)),
        jnp.asarray(points),
        Rays(jnp.asarray(rays.coordinates), jnp.asarray(rays.sigmas)),
        _groups(tables),
        check_points,
    )


def _camera(name: str, section: CameraSection) -> Camera:
    unit = "mm" if section.in_mm else "px"
    metric = section.pixel_size is not None and not section.in_mm
    return Camera(name, section.model, unit, section.width, section.height, metric)


def _interior(
    sections: list[CameraSection],
) -> tuple[Float[np.ndarray, "camera element"], Bool[np.ndarray, "camera element"]]:
    """Interior elements in the order of each model, padded with ones, and which of them are unknown."""
    length = max((len(section.model.elements) for section in sections), default=0)
    elements, free = np.ones((len(sections), length)), np.zeros((len(sections), length), bool)
    for row, section in enumerate(sections):
        x0, y0 = section.principal_point or (0.0, 0.0)
        given = {
            "principal_distance": section.principal_distance,
            "x0": x0,
            "y0": y0,
            "pixel_size": 1.0 if section.in_mm else section.pixel_size or 1.0,
            "y_axis": 1.0 if section.in_mm else -1.0,
            **section.coefficients,
            **(section.corrections.coefficients if section.corrections else {}),
        }
        for k, name in enumerate(section.model.elements):
            elements[row, k] = given.get(name, 0.0)
            free[row, k] = name in section.estimate
    return elements, free


def _datum(
    toml: BlockToml, settings: Settings, images: ImageRows, findings: Findings
) -> tuple[Datum, Bool[np.ndarray, "image 6"]]:
    """The datum and the free elements of the images."""
    free = np.ones((len(images.names), 6), bool)
    if settings.datum is None:
        return Datum("open"), free
    elements = ("X0", "Y0", "Z0", *ROTATION_SYSTEMS[settings.rotation.system].angles)
    position = {name: i for i, name in enumerate(images.names)}
    held = [(image, element) for image, names in settings.datum.hold.items() for element in names]
    for image, element in held:
        line = toml.line("datum", "hold", image)
        if image not in position:
            findings.add(FILE, line, f"[datum] image {image} is not in {images.table.file}", "correct its name")
        elif element not in elements:
            findings.add(FILE, line, f"[datum] element {element} is unknown", f"known: {', '.join(elements)}")
        else:
            free[position[image], elements.index(element)] = False
    return Datum(settings.datum.type if held else "open", tuple(held)), free


def _object_points(
    rays: RayRows, known: dict[str, KnownRows]
) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, "point 3"]]:
    """Approximate coordinates from points.csv, else from control.csv, else NaN; held ones have their control's."""
    points, free = np.full((len(rays.points), 3), np.nan), np.ones((len(rays.points), 3), bool)
    for rows in (known[kind] for kind in ("control", "points") if kind in known):
        row, k = np.nonzero((rows.position >= 0)[:, None] & np.isfinite(rows.coordinates))
        points[rows.position[row], k] = rows.coordinates[row, k]
    if "control" in known:
        control = known["control"]
        row, k = np.nonzero(control.held)
        points[control.position[row], k] = control.coordinates[row, k]
        free[control.position[row], k] = False
    return points, free


def _check_points(control: KnownRows | None) -> tuple[Int[np.ndarray, " check"], CheckPoints]:
    if control is None:
        return np.zeros(0, np.int32), CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3)))
    rows = np.flatnonzero(control.check & (control.position >= 0))
    known = CheckPoints(jnp.asarray(control.coordinates[rows]), jnp.asarray(control.sigmas[rows]))
    return control.position[rows].astype(np.int32), known


def _groups(tables: FolderTables) -> tuple[ObservationGroup, ...]:
    """Observations of control coordinates, stations and distances, as far as there are any."""
    groups = [
        _coordinate_group(kind, tables.known[kind.name])
        for kind in (CONTROL, STATIONS)
        if kind.name in tables.known and len(tables.known[kind.name].members)
    ]
    if tables.distances:
        ends = tables.distances.points
        rows = (ends >= 0).all(1)
        distances, sigmas = tables.distances.values[rows], tables.distances.sigmas[rows]
        groups.append(observation_group(DISTANCES, ends[rows], distances, sigmas))
    return tuple(groups)


def _coordinate_group(kind: ObservationKind, rows: KnownRows) -> ObservationGroup:
    members = rows.members
    values = np.where(rows.observed, rows.coordinates, np.nan)[members]
    return observation_group(kind, rows.position[members, None], values, rows.sigmas[members])


def _notes(folder: Path, toml: BlockToml, settings: Settings, tables: FolderTables) -> tuple[str, ...]:
    """What takes no part, one sentence each."""
    notes = []
    for kind, what in (("control", "control"), ("points", "approximate")):
        if kind in tables.known:
            rows = tables.known[kind]
            unseen = [rows.names[row] for row in np.flatnonzero(rows.position < 0)]
            if len(unseen) == 1:
                notes.append(f"{what} point {unseen[0]} is on no image and takes no part")
            elif unseen:
                notes.append(f"{len(unseen)} {what} points are on no image and take no part: {listed(unseen)}")
    unused = [name for name in settings.cameras if name not in tables.images.camera]
    notes += [f"camera {name} has no image and takes no part" for name in unused]
    files = [file for file in USUAL_FILES if file not in toml.tables.values() and (folder / file).exists()]
    return (*notes, *(f"{file} is not named in [tables] of {FILE} and takes no part" for file in files))


def _names(structure: Structure, problem: Problem) -> set[str]:
    """Names of the image or the point that a problem of a row is about."""
    if problem.row is None:
        return set()
    if problem.table == "rays":
        return {structure.point_names[structure.ray_point[problem.row]]}
    return {(structure.image_names if problem.table == "images" else structure.point_names)[problem.row]}


def _place(problem: Problem, block: Block, toml: BlockToml, tables: FolderTables) -> tuple[str, int]:
    """File and line of a problem of the block."""
    row, kind = problem.row, problem.table
    if kind == "cameras" and row is not None:
        return FILE, toml.line("cameras", block.structure.cameras[row].name)
    if kind == "points":  # a point stands where it is first seen
        kind, row = "rays", int(np.argmax(block.structure.ray_point == row))
    if kind in tables.known:
        rows = tables.known[kind]
        return rows.table.file, 0 if row is None else int(rows.table.lines[rows.members[row]])
    others = {"images": tables.images, "rays": tables.rays, "distances": tables.distances}
    rows = others.get(kind)
    if rows is None:
        return "", 0
    return rows.table.file, 0 if row is None else int(rows.table.lines[row])
