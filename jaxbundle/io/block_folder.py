"""Reading a block folder, format 1: block.toml and its tables.

All problems of the folder are reported at once, with file, line and remedy.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

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
from jaxbundle.block.changes import with_findings
from jaxbundle.block.datum_defect import datum_defect
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.block.unknowns import without_orientation
from jaxbundle.block.validate import validate, weaknesses
from jaxbundle.block.wording import RADIANS
from jaxbundle.diagnosis.before import prepared
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_toml import FILE, BlockToml, read_block_toml
from jaxbundle.io.fiducial_tables import with_inner_orientations
from jaxbundle.io.file_problems import told_of
from jaxbundle.io.folder_tables import FolderTables, RayRows, checked_tables, read_tables
from jaxbundle.io.known_tables import KnownRows
from jaxbundle.io.noted import Noted, listed
from jaxbundle.io.observation_groups import found_in, interior_groups, interior_values
from jaxbundle.io.settings import CameraSection, DatumSection, Settings
from jaxbundle.io.tables import Table
from jaxbundle.io.unused import unused
from jaxbundle.orientation.intersection import intersect
from jaxbundle.orientation.planes_and_lines import with_planes_and_lines


def read_block_folder(path: str | Path, *, check_start: bool = True) -> Block:
    """Reads a block from a folder; points without approximate coordinates are intersected.

    `check_start`: as for `read`. Without it, orientations that are not given are NaN, as `approximate` expects them.

    Raises: BlockError with all problems.

    Example:
        >>> jb.io.read_block_folder("quarry")
        <Block quarry: 4 images, 8 points, 32 rays, 1 camera, 12 control>
    """
    folder, noted = Path(path), Noted()
    if not folder.is_dir():
        raise BlockError([Problem(f"{shown(str(folder))} is not a folder", f"give the path of a folder with {FILE}")])
    toml = read_block_toml(folder / FILE, noted)
    return block_of(toml, read_tables(folder, toml, noted), noted, folder, check_start=check_start)


def block_of(
    toml: BlockToml, read: dict[str, Table | None], noted: Noted, folder: Path | None, *, check_start: bool
) -> Block:
    """Makes the block of settings and tables, as far as these could be read; `folder` is their folder, None for frames.

    Raises: BlockError with all problems.
    """
    tables = checked_tables(read, toml, noted)
    if tables is not None:
        tables = with_inner_orientations(tables, toml, noted)
    settings = toml.settings
    if settings is None or tables is None:
        raise noted.error()
    block = _block(folder, toml, settings, tables, noted)
    if noted:
        problems = weaknesses(block)
    elif check_start or not without_orientation(block).any():
        block = intersect(block)
        block, problems = with_planes_and_lines(with_findings(*prepared(block)) if check_start else block)
        problems = problems or validate(block) or _wrong_elements(block, settings.datum)
    else:
        problems = weaknesses(block)
    told_of(problems, block, toml, tables, noted)
    if noted:
        raise noted.error()
    return block


def _block(folder: Path | None, toml: BlockToml, settings: Settings, tables: FolderTables, noted: Noted) -> Block:
    """The block without the rows that refer to unknown names; these rows are noted as problems."""
    images, rays, known = tables.images, tables.rays, tables.known
    used = {name: section for name, section in settings.cameras.items() if name in images.camera}
    elements, interior_free = _interior(list(used.values()))
    datum, exterior_free = _datum(toml, settings, tables, noted)
    found = found_in(tables, toml, settings)
    groups = (*found.groups, *interior_groups(list(used.values())))
    points, point_free = _object_points(rays, known)
    check, check_points = _check_points(known.get("control"))
    structure = Structure(
        name=settings.name or (folder.resolve().name if folder else ""),
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
        findings=unused(folder, toml, settings, tables, noted),
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
    toml: BlockToml, settings: Settings, tables: FolderTables, noted: Noted
) -> tuple[Datum, Bool[np.ndarray, "image 6"]]:
    """The datum and the free elements of the images."""
    images = tables.images
    free = np.ones((len(images.names), 6), bool)
    if settings.datum is None:
        return Datum("open"), free
    if settings.datum.type == "inner":
        return _free_network(toml, settings.datum, tables, noted), free
    elements = ("X0", "Y0", "Z0", *ROTATION_SYSTEMS[settings.rotation.system].angles)
    position = {name: i for i, name in enumerate(images.names)}
    held = [(image, element) for image, names in settings.datum.hold.items() for element in names]
    lost = [image for image in settings.datum.hold if image not in position]
    odd = dict.fromkeys(element for _, element in held if element not in elements)
    for names, what, cure in (
        (lost, f"not in {images.table.file}", "correct the name"),
        (list(odd), "unknown", f"known: {', '.join(elements)}"),
    ):
        if names:
            called = "image" if names is lost else "element"
            image = names[0] if names is lost else next(image for image, element in held if element in odd)
            are = f"{called} {listed(names)} is" if len(names) == 1 else f"{called}s {listed(names)} are"
            noted.add(FILE, toml.line("datum", "hold", image), f"[datum] {are} {what}", cure)
    for image, element in held:
        if image in position and element in elements:
            free[position[image], elements.index(element)] = False
    return Datum(settings.datum.type if held else "open", tuple(held)), free


def _free_network(toml: BlockToml, section: DatumSection, tables: FolderTables, noted: Noted) -> Datum:
    """The datum of a free network; names that are not object points are noted."""
    named = tuple(dict.fromkeys(section.points or ()))
    known = set(tables.rays.points)
    absent = [point for point in named if point not in known]
    if absent:
        what = f"[datum] {'point' if len(absent) == 1 else 'points'} {listed(absent)}"
        what += f" {'is' if len(absent) == 1 else 'are'} not in {tables.rays.table.file}"
        cure = "correct its name or drop it" if len(absent) == 1 else "correct their names or drop them"
        noted.add(FILE, toml.line("datum", "points"), what, cure)
    return Datum("inner", points=named)


def _wrong_elements(block: Block, section: DatumSection | None) -> list[Problem]:
    """Notes inner constraints that include a determined scale, or exclude one that is not determined."""
    if section is None or section.elements is None:
        return []
    open_scale, wanted = datum_defect(block).scale, "scale" in section.elements
    if open_scale == wanted:
        return []
    if wanted:
        what = "[datum] elements include the scale, but observed distances or scale bars determine it"
        return [Problem(what, 'drop "scale" from elements, or drop the observations that determine it', "datum")]
    what = "[datum] elements exclude the scale, and no observed distance or scale bar determines it"
    return [Problem(what, 'add "scale" to elements, or observe a distance', "datum")]


def _object_points(
    rays: RayRows, known: dict[str, KnownRows]
) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, "point 3"]]:
    """Approximate coordinates from points.csv, else from control.csv, else NaN; fixed ones from the control."""
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
