"""The block folder, format 1: block.toml and tables, read to a block.

Everything that is wrong in the whole folder is told at once, with file, line and cure.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.approximate.figures import with_figures
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
from jaxbundle.block.datum_defect import datum_defect
from jaxbundle.block.findings import Finding as Note
from jaxbundle.block.findings import Kind
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.validate import validate, weaknesses
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_toml import FILE, BlockToml, read_block_toml
from jaxbundle.io.fiducial_tables import with_inner_orientations
from jaxbundle.io.findings import Finding, Findings
from jaxbundle.io.folder_tables import USUAL_FILES, FolderTables, KnownRows, RayRows, read_folder_tables
from jaxbundle.io.observation_groups import found_in, interior_groups, interior_values
from jaxbundle.io.observation_tables import unused
from jaxbundle.io.settings import RADIANS, CameraSection, DatumSection, Settings
from jaxbundle.io.tables import listed


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
    settings = toml.settings
    if settings is None or tables is None:
        raise findings.error()
    block = _block(folder, toml, settings, tables, findings)
    if findings:
        problems = [p for p in weaknesses(block) if findings.touched.isdisjoint(_names(block.structure, p))]
    else:
        block, problems = with_figures(intersect(block))
        problems = problems or validate(block) or _wrong_elements(block, settings.datum)
    findings.found += [Finding(*_place(problem, block, toml, tables), problem) for problem in problems]
    if findings:
        raise findings.error()
    return block


def _block(folder: Path, toml: BlockToml, settings: Settings, tables: FolderTables, findings: Findings) -> Block:
    """The block; where something was found it lacks the rows that refer to nothing known."""
    images, rays, known = tables.images, tables.rays, tables.known
    used = {name: section for name, section in settings.cameras.items() if name in images.camera}
    elements, interior_free = _interior(list(used.values()))
    datum, exterior_free = _datum(toml, settings, tables, findings)
    found = found_in(tables, toml, settings)
    groups = (*found.groups, *interior_groups(list(used.values())))
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
        parameters=tuple(found.parameters),
        source=settings.source,
        findings=_unused(folder, toml, settings, tables),
        inner_orientations=tables.inner_orientations,
    )
    return Block(
        structure,
        ExteriorOrientation(jnp.asarray(images.centre), jnp.asarray(images.angles * RADIANS[settings.units.angle])),
        InteriorOrientation(jnp.asarray(elements)),
        jnp.asarray(points),
        Rays(jnp.asarray(rays.coordinates), jnp.asarray(rays.sigmas)),
        groups,
        check_points,
        jnp.asarray(found.values, float),
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
        given = interior_values(section)
        for k, name in enumerate(section.model.elements):
            elements[row, k] = given.get(name, 0.0)
            free[row, k] = name in section.estimate
    return elements, free


def _datum(
    toml: BlockToml, settings: Settings, tables: FolderTables, findings: Findings
) -> tuple[Datum, Bool[np.ndarray, "image 6"]]:
    """The datum and the free elements of the images."""
    images = tables.images
    free = np.ones((len(images.names), 6), bool)
    if settings.datum is None:
        return Datum("open"), free
    if settings.datum.type == "inner":
        return _free_network(toml, settings.datum, tables, findings), free
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


def _free_network(toml: BlockToml, section: DatumSection, tables: FolderTables, findings: Findings) -> Datum:
    """The datum of a free network; points that are none are noted."""
    named = tuple(dict.fromkeys(section.points or ()))
    for point in sorted(set(named).difference(tables.rays.points), key=named.index):
        what = f"[datum] point {point} is not in {tables.rays.table.file}"
        findings.add(FILE, toml.line("datum", "points"), what, "correct its name or drop it")
    return Datum("inner", points=named)


def _wrong_elements(block: Block, section: DatumSection | None) -> list[Problem]:
    """The problem of inner constraints that name the scale where observations give it, or do not where none does."""
    if section is None or section.elements is None:
        return []
    open_scale, wanted = datum_defect(block).scale, "scale" in section.elements
    if open_scale == wanted:
        return []
    if wanted:
        what = "[datum] elements name the scale, which observed distances or scale bars give already"
        return [Problem(what, 'drop "scale" from elements, or the observations that give it', "datum")]
    what = "[datum] elements do not name the scale, and no observed distance and no scale bar gives it"
    return [Problem(what, 'add "scale" to elements, or observe a distance', "datum")]


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


def _unused(folder: Path, toml: BlockToml, settings: Settings, tables: FolderTables) -> tuple[Note, ...]:
    """What takes no part, one sentence each."""
    notes: list[str] = []
    for kind, what in (("control", "control"), ("points", "approximate")):
        if kind in tables.known:
            rows = tables.known[kind]
            unseen = [rows.names[row] for row in np.flatnonzero(rows.position < 0)]
            if len(unseen) == 1:
                notes.append(f"{what} point {unseen[0]} is on no image and takes no part")
            elif unseen:
                notes.append(f"{len(unseen)} {what} points are on no image and take no part: {listed(unseen)}")
    without_image = [name for name in settings.cameras if name not in tables.images.camera]
    notes += [f"camera {name} has no image and takes no part" for name in without_image]
    if tables.bars:
        used = tables.pairs["scale_bars"].owner.tolist() if "scale_bars" in tables.pairs else ()
        notes += unused(tables.bars.names, used, "bar")
    groups = tables.navigation
    taken = {int(k) for rows in groups.rows.values() for k in rows.group}
    notes += unused(groups.names, taken, "navigation group")
    times = [
        f"times of navigation group {name} count from their mean, {origin:.10g}"
        for name, origin in zip(groups.names, groups.origin.tolist(), strict=True)
        if origin
    ]
    files = [file for file in USUAL_FILES if file not in toml.tables.values() and (folder / file).exists()]
    notes += [f"{file} is not named in [tables] of {FILE} and takes no part" for file in files]
    return (*(Note(Kind.UNUSED, note) for note in notes), *(Note(Kind.INFORMATION, time) for time in times))


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
    if kind == "datum":
        return FILE, toml.line("datum", "elements")
    if kind == "points" and row is not None:
        return _place_of_point(row, block.structure, tables)
    table = tables.table(kind)
    if table is None:
        return "", 0
    if row is not None and kind in tables.known:
        row = tables.known[kind].members[row]
    return table.file, 0 if row is None else int(table.lines[row])


def _place_of_point(point: int, structure: Structure, tables: FolderTables) -> tuple[str, int]:
    """Where a point is first seen; of one on no image, where its coordinates stand."""
    rays = np.flatnonzero(structure.ray_point == point)
    if len(rays):
        return tables.rays.table.file, int(tables.rays.table.lines[rays[0]])
    for rows in (tables.known[kind] for kind in ("points", "control") if kind in tables.known):
        if point in rows.position:
            return rows.table.file, int(rows.table.lines[np.argmax(rows.position == point)])
    return "", 0
