"""The tables of a block folder, each read and checked against those it refers to.

Rows that refer to nothing known keep the position -1: they are noted, and the block is not used.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import CENTRE_ELEMENTS
from jaxbundle.block.problems import shown
from jaxbundle.camera.fiducials import InnerOrientation
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.control_columns import OPTIONAL, covariances, identification
from jaxbundle.io.header import APPROXIMATE
from jaxbundle.io.navigation_tables import Navigation, navigation
from jaxbundle.io.noted import Noted
from jaxbundle.io.observation_tables import (
    COLUMNS,
    FIGURES,
    PAIRS,
    BarRows,
    Entities,
    FigureRows,
    PairRows,
    bar_rows,
    figure_rows,
    pair_rows,
    points_named,
)
from jaxbundle.io.ranges import LARGEST_IMAGE_COORDINATE, LARGEST_LENGTH, largest_angle
from jaxbundle.io.remarks import measured_again
from jaxbundle.io.tables import GIVE, Table, positions_of, read_table, where

NO_ANGLES = ("image", "camera", *CENTRE_ELEMENTS)  # of images.csv
COORDINATES = ("X", "Y", "Z")
SIGMAS = ("sX", "sY", "sZ")
Columns = tuple[str, tuple[str, ...], tuple[str, ...]]  # what a row is about, columns needed, optional ones
ROLES = ("control", "check")
FIDUCIAL_TABLES = ("fiducials", "fiducial_rays")
KNOWN = ("points", "control", "stations", "attitudes")
USUAL_FILES = tuple(f"{kind}.csv" for kind in (*KNOWN, *COLUMNS, *FIDUCIAL_TABLES))


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
    """rays.csv; `points` are those it names, in the order of their first appearance, then those on no image."""

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
class KnownRows:
    """points.csv, control.csv, stations.csv or attitudes.csv: coordinates of points or images, or angles; NaN where not
    given.

    `covariances` of control, None where they are not correlated.
    """

    table: Table
    names: tuple[str, ...]
    position: Int[np.ndarray, " row"]
    coordinates: Float[np.ndarray, "row 3"]
    sigmas: Float[np.ndarray, "row 3"]
    check: Bool[np.ndarray, " row"]
    covariances: Float[np.ndarray, "row 3 3"] | None = None

    @property
    def held(self) -> Bool[np.ndarray, "row 3"]:
        """Coordinates of sigma 0."""
        return self._takes_part & (self.sigmas == 0)

    @property
    def observed(self) -> Bool[np.ndarray, "row 3"]:
        """Coordinates with a weight."""
        return self._takes_part & (self.sigmas > 0)

    @property
    def members(self) -> Int[np.ndarray, " member"]:
        """Rows with a weighted coordinate."""
        return np.flatnonzero(self.observed.any(1))

    @property
    def _takes_part(self) -> Bool[np.ndarray, "row 3"]:
        return ((self.position >= 0) & ~self.check)[:, None] & np.isfinite(self.coordinates)


@dataclass(frozen=True)
class FolderTables:
    """All tables; `known` are points, control, stations and attitudes as far as they are given.

    Tables of fiducials are as they were read; `inner_orientations` are their fits, once there are any.
    """

    images: ImageRows
    rays: RayRows
    known: dict[str, KnownRows]
    pairs: dict[str, PairRows]
    figures: dict[str, FigureRows]
    bars: BarRows | None
    navigation: Navigation
    fiducials: Table | None = None
    fiducial_rays: Table | None = None
    inner_orientations: tuple[InnerOrientation, ...] = ()

    @property
    def angles(self) -> tuple[str, ...]:
        """Names of the three angles."""
        return tuple(column for column in self.images.table.text.columns if column not in NO_ANGLES)

    def table(self, kind: str) -> Table | None:
        """The table of a kind of observation."""
        rows = {"images": self.images, "rays": self.rays, **self.known, **self.pairs, **self.figures}.get(kind)
        return rows.table if rows else None


def _table(folder: Path, toml: BlockToml, kind: str, columns: Columns, noted: Noted) -> Table | None:
    """A table that block.toml names; files elsewhere are refused, so that a folder tells nothing but its own content.

    Links in the folder are followed.
    """
    file = toml.tables[kind]
    if Path(file).is_absolute() or ".." in Path(file).parts:
        what = f"[tables] {kind} = '{shown(file)}' leads out of the folder"
        noted.add(FILE, toml.line("tables", kind), what, "copy or link the table into the folder, and give its name")
        return None
    return read_table(folder / file, *columns, noted)


def read_folder_tables(folder: Path, toml: BlockToml, noted: Noted) -> FolderTables | None:
    """Every table that block.toml names; None where one cannot be read as a table."""
    angles = toml.rotation_system.angles
    columns: dict[str, Columns] = {
        "images": ("image {image}", ("image", "camera", *CENTRE_ELEMENTS, *angles), ()),
        "rays": ("point {point} on image {image}", ("image", "point", "x", "y"), ("sx", "sy")),
        "points": ("point {point}", ("point", *COORDINATES), ()),
        "control": ("point {point}", ("point", *COORDINATES, *SIGMAS, "role"), OPTIONAL),
        "stations": ("image {image}", ("image", *COORDINATES, *SIGMAS), ("group", "time")),
        "attitudes": ("image {image}", ("image", *angles, *(f"s{a}" for a in angles)), ("group", "time")),
        **COLUMNS,
        "fiducials": ("fiducial {fiducial} of camera {camera}", ("camera", "fiducial", "x", "y"), ()),
        "fiducial_rays": ("fiducial {fiducial} on image {image}", ("image", "fiducial", "x", "y"), ()),
    }
    read = {
        kind: _table(folder, toml, kind, of_kind, noted) for kind, of_kind in columns.items() if kind in toml.tables
    }
    tables = {kind: table for kind, table in read.items() if table is not None}
    images = _images(tables["images"], toml) if "images" in tables else None
    rays = _rays(tables["rays"], images, toml) if "rays" in tables else None
    if images is None or rays is None:
        return None
    rays = dataclasses.replace(rays, points=(*rays.points, *_on_no_image(tables, rays.points)))
    known = {kind: _known(kind, tables[kind], rays.points, images, toml) for kind in KNOWN if kind in tables}
    pairs, figures, bars = _observations(tables, rays, images, toml, noted)
    groups = navigation(tables, toml)
    if len(tables) < len(read):
        return None
    if "control" in known:
        control = known["control"]
        deviations = identification(control.table, control.position, len(rays.points), toml)
        own = np.where(rays.point >= 0, np.append(deviations, 0.0)[rays.point], 0.0)[:, None]
        rays = dataclasses.replace(rays, sigmas=np.where(own > 0, np.hypot(rays.sigmas, own), rays.sigmas))
    fiducials, fiducial_rays = (tables.get(kind) for kind in FIDUCIAL_TABLES)
    return FolderTables(images, rays.usable(), known, pairs, figures, bars, groups, fiducials, fiducial_rays)


def _on_no_image(tables: dict[str, Table], points: Sequence[str]) -> tuple[str, ...]:
    """Points that take part though on no image: observations name them, and their coordinates are given."""
    unseen = set(points_named(tables)).difference(points)
    given: dict[str, set[str]] = {}
    for kind in ("points", "control") if unseen else ():
        for row in tables[kind].text.iter_rows(named=True) if kind in tables else ():
            if row["point"] in unseen:
                given.setdefault(row["point"], set()).update(c for c in COORDINATES if row[c])
    return tuple(name for name, coordinates in given.items() if len(coordinates) == len(COORDINATES))


def _observations(
    tables: dict[str, Table], rays: RayRows, images: ImageRows, toml: BlockToml, noted: Noted
) -> tuple[dict[str, PairRows], dict[str, FigureRows], BarRows | None]:
    """Observations between points and images, points on figures, and the lengths of scale bars."""
    entities = Entities(rays.points, images.names, images.table.file, toml.half_turn)
    bars = bar_rows(tables["bars"]) if "bars" in tables else None
    if "scale_bars" in toml.tables and "bars" not in toml.tables:
        line, cure = toml.line("tables", "scale_bars"), 'give a table bar,length,sigma and name it: bars = "bars.csv"'
        noted.add(FILE, line, "[tables] scale_bars need the table bars", cure)
    bars_file = toml.tables.get("bars", "")
    pairs = {kind: pair_rows(kind, tables[kind], entities, bars, bars_file) for kind in PAIRS if kind in tables}
    figures = {kind: figure_rows(kind, tables[kind], rays.points, noted) for kind in FIGURES if kind in tables}
    return pairs, figures, bars


def _images(table: Table, toml: BlockToml) -> ImageRows:
    names = table.names("image")
    table.unique("image")
    cameras = table.text["camera"]
    if toml.camera_names is not None:
        table.positions("camera", toml.camera_names, FILE)
    elements = (*CENTRE_ELEMENTS, *toml.rotation_system.angles)
    largest = (*[LARGEST_LENGTH] * 3, *[largest_angle(toml.half_turn)] * 3)
    orientations = table.numbers(*elements, needed=APPROXIMATE, largest=largest)
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
    coordinates = table.numbers("x", "y", needed=GIVE, largest=LARGEST_IMAGE_COORDINATE)
    _repeated(table, image, coordinates)
    sigmas = table.sigmas("sx", "sy", zero="give a positive one, or leave it empty for the default")
    default = toml.sigma
    if default is None and toml.settings and np.isnan(sigmas).any():
        what = f"[sigma] image is missing, and {np.isnan(sigmas).any(1).sum()} rays have no sx, sy of their own"
        cure = "give the standard deviation of an image coordinate, in the unit of the rays: [sigma] image = 1.0"
        table.noted.add(FILE, 0, what, cure)
    sigmas = np.where(np.isnan(sigmas), np.nan if default is None else default, sigmas)
    return RayRows(table, image, positions_of(points, tuple(distinct)), tuple(distinct), coordinates, sigmas)


def _repeated(table: Table, image: Int[np.ndarray, " row"], coordinates: Float[np.ndarray, "row 2"]) -> None:
    """Notes a row that repeats another one; a point measured again on an image is two observations, and is remarked."""
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


def _one_role(table: Table) -> None:
    """Notes a control point that stands in two rows, with two roles or with one."""
    rows, first = table.repeated("point")
    role = table.text["role"].str.to_lowercase()
    roles = dict(zip(rows.tolist(), zip(role.gather(first), table.lines[first].tolist(), strict=True), strict=True))
    two = (role.gather(rows) != role.gather(first)).to_numpy()
    for kind, what in (
        (rows[~two], lambda row: f"is already in line {roles[row][1]}"),
        (rows[two], lambda row: f"is {role[row]} here and {roles[row][0]} in line {roles[row][1]}"),
    ):
        table.note(kind, what, "drop one of the two")


def _known(kind: str, table: Table, points: Sequence[str], images: ImageRows, toml: BlockToml) -> KnownRows:
    of_images = kind in ("stations", "attitudes")
    if of_images:
        known, position = table.text["image"], table.positions("image", images.names, images.table.file)
        table.unique("image")
    else:  # a point may be on no image
        known = table.names("point")
        position = positions_of(known, points)
        _one_role(table) if kind == "control" else table.unique("point")
    columns = toml.rotation_system.angles if kind == "attitudes" else COORDINATES
    coordinates = table.numbers(
        *columns, largest=largest_angle(toml.half_turn) if kind == "attitudes" else LARGEST_LENGTH
    )
    if kind == "points":
        nothing = np.full_like(coordinates, np.nan)
        return KnownRows(table, tuple(known), position, coordinates, nothing, np.zeros(len(known), bool))
    zero = "give a positive one; [datum] in block.toml holds elements of images" if of_images else ""
    sigmas = table.sigmas(*(f"s{column}" for column in columns), zero=zero)
    for k, name in enumerate(columns):
        rows = np.flatnonzero((sigmas[:, k] == 0) & np.isnan(coordinates[:, k]))
        table.note(rows, f"s{name} = 0 holds {name}, which is not given", f"give {name} or leave s{name} empty")
    rows = KnownRows(table, tuple(known), position, coordinates, sigmas, np.zeros(len(known), bool))
    if kind != "control":
        return rows
    role = table.text["role"].str.to_lowercase()
    table.note(where(role == ""), "role is not given", f"give one of {', '.join(ROLES)}")
    unknown = where(~role.is_in(["", *ROLES]))
    table.note(unknown, lambda row: f"role '{shown(role[row])}' is unknown", f"known: {', '.join(ROLES)}")
    observed = np.isfinite(coordinates) & (sigmas > 0)
    together = covariances(table, sigmas, observed)
    return dataclasses.replace(rows, check=(role == "check").to_numpy(), covariances=together)
