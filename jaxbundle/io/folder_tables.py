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
from jaxbundle.camera.fiducials import InnerOrientation
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.control_columns import OPTIONAL, covariances, identification
from jaxbundle.io.findings import Findings
from jaxbundle.io.navigation_tables import Navigation, navigation
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
from jaxbundle.io.settings import RADIANS
from jaxbundle.io.tables import Table, positions_of, read_table

COORDINATES = ("X", "Y", "Z")
SIGMAS = ("sX", "sY", "sZ")
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

    def table(self, kind: str) -> Table | None:
        """The table of a kind of observation."""
        rows = {"images": self.images, "rays": self.rays, **self.known, **self.pairs, **self.figures}.get(kind)
        return rows.table if rows else None


def read_folder_tables(folder: Path, toml: BlockToml, findings: Findings) -> FolderTables | None:
    """Every table that block.toml names; None where one cannot be read as a table."""
    angles, files = toml.rotation_system.angles, toml.tables
    columns: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
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
        kind: read_table(folder / files[kind], subject, needed, optional, findings)
        for kind, (subject, needed, optional) in columns.items()
        if kind in files
    }
    tables = {kind: table for kind, table in read.items() if table is not None}
    images = _images(tables["images"], toml) if "images" in tables else None
    rays = _rays(tables["rays"], images, toml) if "rays" in tables else None
    if images is None or rays is None:
        return None
    rays = dataclasses.replace(rays, points=(*rays.points, *_on_no_image(tables, rays.points)))
    known = {kind: _known(kind, tables[kind], rays.points, images, toml) for kind in KNOWN if kind in tables}
    pairs, figures, bars = _observations(tables, rays, images, toml, findings)
    groups = navigation(tables, toml)
    if len(tables) < len(read):
        return None
    if "control" in known:
        control = known["control"]
        deviations = identification(control.table, control.position, len(rays.points), toml)
        own = np.where(rays.point >= 0, deviations[rays.point], 0.0)[:, None]
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
    tables: dict[str, Table], rays: RayRows, images: ImageRows, toml: BlockToml, findings: Findings
) -> tuple[dict[str, PairRows], dict[str, FigureRows], BarRows | None]:
    """Observations between points and images, points on figures, and the lengths of scale bars."""
    unit = toml.settings.units.angle if toml.settings else "deg"
    entities = Entities(rays.points, images.names, images.table.file, np.pi / RADIANS[unit])
    bars = bar_rows(tables["bars"]) if "bars" in tables else None
    if "scale_bars" in toml.tables and "bars" not in toml.tables:
        line, cure = toml.line("tables", "scale_bars"), 'give a table bar,length,sigma and name it: bars = "bars.csv"'
        findings.add(FILE, line, "[tables] scale_bars need the table bars", cure)
    bars_file = toml.tables.get("bars", "")
    pairs = {kind: pair_rows(kind, tables[kind], entities, bars, bars_file) for kind in PAIRS if kind in tables}
    figures = {kind: figure_rows(kind, tables[kind], rays.points, findings) for kind in FIGURES if kind in tables}
    return pairs, figures, bars


def _images(table: Table, toml: BlockToml) -> ImageRows:
    names = table.names("image")
    table.unique("image")
    cameras = table.names("camera")
    if toml.camera_names is not None:
        table.positions("camera", toml.camera_names, "block.toml")
    centre = table.numbers(*CENTRE_ELEMENTS, needed=True)
    angles = table.numbers(*toml.rotation_system.angles, needed=True)
    return ImageRows(table, tuple(names), tuple(cameras), centre, angles)


def _rays(table: Table, images: ImageRows | None, toml: BlockToml) -> RayRows:
    points = table.names("point")
    distinct = points.unique(maintain_order=True)
    distinct = distinct.filter(distinct != "")
    if images:
        image = table.positions("image", images.names, images.table.file)
    else:
        image = np.zeros(len(points), int)
    table.unique("image", "point")
    coordinates = table.numbers("x", "y", needed=True)
    sigmas = table.sigmas("sx", "sy", zero="give a positive one, or leave it empty for the default")
    default = toml.sigma
    if default is None and toml.settings and np.isnan(sigmas).any():
        what = f"[sigma] image is missing, and {np.isnan(sigmas).any(1).sum()} rays have no sx, sy of their own"
        table.findings.add("block.toml", 0, what, "give the standard deviation of an image coordinate")
    sigmas = np.where(np.isnan(sigmas), np.nan if default is None else default, sigmas)
    return RayRows(table, image, positions_of(points, tuple(distinct)), tuple(distinct), coordinates, sigmas)


def _known(kind: str, table: Table, points: Sequence[str], images: ImageRows, toml: BlockToml) -> KnownRows:
    of_images = kind in ("stations", "attitudes")
    if of_images:
        known, position = table.text["image"], table.positions("image", images.names, images.table.file)
        table.unique("image")
    else:  # a point may be on no image
        known = table.names("point")
        position = positions_of(known, points)
        table.unique("point")
    columns = toml.rotation_system.angles if kind == "attitudes" else COORDINATES
    coordinates = table.numbers(*columns)
    if kind == "points":
        nothing = np.full_like(coordinates, np.nan)
        return KnownRows(table, tuple(known), position, coordinates, nothing, np.zeros(len(known), bool))
    zero = "give a positive one; [datum] in block.toml holds elements of images" if of_images else ""
    sigmas = table.sigmas(*(f"s{column}" for column in columns), zero=zero)
    for row, k in np.argwhere((sigmas == 0) & np.isnan(coordinates)).tolist():
        name = columns[k]
        table.note(row, f"s{name} = 0 holds {name}, which is not given", f"give {name} or leave s{name} empty")
    rows = KnownRows(table, tuple(known), position, coordinates, sigmas, np.zeros(len(known), bool))
    if kind != "control":
        return rows
    role = table.text["role"]
    for row in (~role.is_in(ROLES)).arg_true():
        table.note(row, f"role '{role[row]}' is unknown", f"known: {', '.join(ROLES)}")
    observed = np.isfinite(coordinates) & (sigmas > 0)
    together = covariances(table, sigmas, observed)
    return dataclasses.replace(rows, check=(role == "check").to_numpy(), covariances=together)
