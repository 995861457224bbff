"""The tables of a block folder, each read and checked against the tables that it refers to.

Rows that refer to an unknown name have the index -1: they are noted, and the block is not used.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.camera.fiducials import InnerOrientation
from jaxbundle.io.block_tables import COORDINATES, TABLES
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.known_tables import KNOWN, KnownRows, identification, known_rows
from jaxbundle.io.navigation_tables import Navigation, navigation
from jaxbundle.io.noted import Noted, measured_again
from jaxbundle.io.observation_tables import Entities, ObservedRows, OwnerRows, observed_rows, owner_rows, points_named
from jaxbundle.io.schema import Holds
from jaxbundle.io.tables import Table, positions_of, read_table

FIDUCIAL_TABLES = ("fiducials", "fiducial_rays")


@dataclass(frozen=True)
class ImageRows:
    """images.csv; angles in the unit of the folder."""

    table: Table
    names: tuple[str, ...]
    camera: tuple[str, ...]
    centre: Float[np.ndarray, "image 3"]
    angles: Float[np.ndarray, "image 3"]


@dataclass(frozen=True)
class RayRows:
    """rays.csv; `points` are its points in the order of their first row, then the points on no image."""

    table: Table
    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    points: tuple[str, ...]
    coordinates: Float[np.ndarray, "ray 2"]
    sigmas: Float[np.ndarray, "ray 2"]

    def usable(self) -> "RayRows":
        """The rays whose image and point are known."""
        rows = np.flatnonzero((self.image >= 0) & (self.point >= 0))
        table = dataclasses.replace(self.table, text=self.table.text[rows], lines=self.table.lines[rows])
        return RayRows(
            table, self.image[rows], self.point[rows], self.points, self.coordinates[rows], self.sigmas[rows]
        )


@dataclass(frozen=True)
class FolderTables:
    """All tables; `known` are points, control, stations and attitudes, where given.

    `observed` are tables of observations that are read by their schemas, `owners` those with the values of
    owners. Tables of fiducials are unchanged; `inner_orientations` are their fits, once there are any.
    """

    images: ImageRows
    rays: RayRows
    known: dict[str, KnownRows]
    observed: dict[str, ObservedRows]
    owners: dict[str, OwnerRows]
    navigation: Navigation
    fiducials: Table | None = None
    fiducial_rays: Table | None = None
    inner_orientations: tuple[InnerOrientation, ...] = ()

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of the three angles."""
        return self.images.table.schema.of(Holds.VALUE)[3:]

    def table(self, kind: str) -> Table | None:
        """The table of a kind of observation."""
        rows = {"images": self.images, "rays": self.rays, **self.known, **self.observed}.get(kind)
        return rows.table if rows else None


def _table(folder: Path, toml: BlockToml, kind: str, noted: Noted) -> Table | None:
    """A table that block.toml names; files elsewhere are refused, so that a folder cannot reveal other files.

    Links in the folder are followed.
    """
    file = toml.tables[kind]
    if Path(file).is_absolute() or ".." in Path(file).parts:
        what = f"[tables] {kind} = '{shown(file)}' is outside the folder"
        noted.add(FILE, toml.line("tables", kind), what, "copy or link the table into the folder, and write its name")
        return None
    return read_table(folder / file, TABLES[kind].in_system(toml.rotation_system), noted, toml.half_turn)


def read_tables(folder: Path, toml: BlockToml, noted: Noted) -> dict[str, Table | None]:
    """All tables that block.toml names; None for one that cannot be read as a table."""
    return {kind: _table(folder, toml, kind, noted) for kind in TABLES if kind in toml.tables}


def checked_tables(read: dict[str, Table | None], toml: BlockToml, noted: Noted) -> FolderTables | None:
    """The tables checked against each other; None where one could not be read."""
    tables = {kind: table for kind, table in read.items() if table is not None}
    images = _images(tables["images"], toml) if "images" in tables else None
    rays = _rays(tables["rays"], images, toml) if "rays" in tables else None
    if images is None or rays is None:
        return None
    rays = dataclasses.replace(rays, points=(*rays.points, *_on_no_image(tables, rays.points)))
    known = {k: known_rows(tables[k], rays.points, images.names, images.table.file) for k in KNOWN if k in tables}
    observed, owners = _observations(tables, rays, images, toml, noted)
    groups = navigation(tables, toml)
    if len(tables) < len(read):
        return None
    if "control" in known:
        control = known["control"]
        deviations = identification(control.table, control.position, len(rays.points), toml)
        own = np.where(rays.point >= 0, np.append(deviations, 0.0)[rays.point], 0.0)[:, None]
        rays = dataclasses.replace(rays, sigmas=np.where(own > 0, np.hypot(rays.sigmas, own), rays.sigmas))
    fiducials, fiducial_rays = (tables.get(kind) for kind in FIDUCIAL_TABLES)
    return FolderTables(images, rays.usable(), known, observed, owners, groups, fiducials, fiducial_rays)


def _on_no_image(tables: dict[str, Table], points: Sequence[str]) -> tuple[str, ...]:
    """Points on no image that are used: observations name them, and their coordinates are given."""
    unseen = set(points_named(tables)).difference(points)
    given: dict[str, set[str]] = {}
    for kind in ("points", "control") if unseen else ():
        for row in tables[kind].text.iter_rows(named=True) if kind in tables else ():
            if row["point"] in unseen:
                given.setdefault(row["point"], set()).update(c for c in COORDINATES if row[c])
    return tuple(name for name, coordinates in given.items() if len(coordinates) == len(COORDINATES))


def _observations(
    tables: dict[str, Table], rays: RayRows, images: ImageRows, toml: BlockToml, noted: Noted
) -> tuple[dict[str, ObservedRows], dict[str, OwnerRows]]:
    """Observations between points and images, points on figures, and the lengths of scale bars."""
    owners = {}
    for schema in TABLES.values():
        needed = schema.owner.table if schema.owner else ""
        if needed in tables:
            owners[needed] = owner_rows(tables[needed])
        if needed and schema.name in toml.tables and needed not in toml.tables:
            columns = ",".join(TABLES[needed].names)
            cure = f'add a table {columns} and name it: {needed} = "{TABLES[needed].file}"'
            noted.add(FILE, toml.line("tables", schema.name), f"[tables] {schema.name} need the table {needed}", cure)
    entities = Entities(rays.points, images.names, images.table.file, owners)
    plain = [kind for kind, schema in TABLES.items() if schema.plain and kind in tables]
    return {kind: observed_rows(tables[kind], entities) for kind in plain}, owners


def _images(table: Table, toml: BlockToml) -> ImageRows:
    names = table.names("image")
    table.unique("image")
    cameras = table.text["camera"]
    if toml.camera_names is not None:
        table.positions("camera", toml.camera_names, FILE)
    columns = table.schema.of(Holds.VALUE)
    blank = np.stack([(table.column(column) == "").to_numpy() for column in columns], 1)
    parts = blank[:, :3], blank[:, 3:]
    # a projection centre or attitude may be entirely empty: it is then computed from the rays
    whole = [np.asarray(part.all(1) | ~part.any(1)) for part in parts]
    spared = np.flatnonzero(whole[0] & whole[1])
    orientations = table.numbers(*columns, spared=spared)
    return ImageRows(table, tuple(names), tuple(cameras), orientations[:, :3], orientations[:, 3:])


def _rays(table: Table, images: ImageRows | None, toml: BlockToml) -> RayRows:
    points = table.names("point")
    distinct = points.unique(maintain_order=True)
    distinct = distinct.filter(distinct != "")
    if images:
        image = table.positions("image", images.names, images.table.file)
        table.noted.lost_images |= bool((image < 0).any())
    else:
        image = np.zeros(len(points), int)
    coordinates = table.numbers("x", "y")
    _repeated(table, image, coordinates)
    sigmas = table.sigmas("sx", "sy")
    default = toml.sigma
    if default is None and toml.settings and np.isnan(sigmas).any():
        what = f"[sigma] image is missing, and {np.isnan(sigmas).any(1).sum()} rays have no sx, sy"
        cure = "add the standard deviation of an image coordinate, in the unit of the rays: [sigma] image = 1.0"
        table.noted.add(FILE, 0, what, cure)
    sigmas = np.where(np.isnan(sigmas), np.nan if default is None else default, sigmas)
    return RayRows(table, image, positions_of(points, tuple(distinct)), tuple(distinct), coordinates, sigmas)


def _repeated(table: Table, image: Int[np.ndarray, " row"], coordinates: Float[np.ndarray, "row 2"]) -> None:
    """Notes rows that repeat another one. A point measured twice on an image is a remark: both are observations."""
    rows, first = table.repeated("image", "point")
    same = np.isin(rows, table.repeated("image", "point", "x", "y")[0]) | (coordinates[rows] == coordinates[first]).all(
        1
    )
    lines = dict(zip(rows.tolist(), table.lines[first].tolist(), strict=True))
    table.note(rows[same], lambda row: f"is already in line {lines[row]}", "drop one of the two")
    again = rows[~same & (image[rows] >= 0)]
    if len(again):
        names = table.text.select("image", "point")[again].rows()
        table.noted.remarks.append(measured_again(names))
