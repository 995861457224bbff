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
from jaxbundle.io.block_toml import BlockToml
from jaxbundle.io.findings import Findings
from jaxbundle.io.tables import Table, positions_of, read_table

COORDINATES = ("X", "Y", "Z")
SIGMAS = ("sX", "sY", "sZ")
ROLES = ("control", "check")
FIDUCIAL_TABLES = ("fiducials", "fiducial_rays")
USUAL_FILES = ("points.csv", "control.csv", "stations.csv", "distances.csv", "fiducials.csv", "fiducial_rays.csv")


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
    """rays.csv and the points it names, in the order of their first appearance."""

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
    """points.csv, control.csv or stations.csv: coordinates of points or images, NaN where not given."""

    table: Table
    names: tuple[str, ...]
    position: Int[np.ndarray, " row"]
    coordinates: Float[np.ndarray, "row 3"]
    sigmas: Float[np.ndarray, "row 3"]
    check: Bool[np.ndarray, " row"]

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
class DistanceRows:
    """distances.csv."""

    table: Table
    points: Int[np.ndarray, "row 2"]
    values: Float[np.ndarray, "row 1"]
    sigmas: Float[np.ndarray, "row 1"]


@dataclass(frozen=True)
class FolderTables:
    """All tables; `known` are points, control and stations as far as they are given.

    Tables of fiducials are as they were read; `inner_orientations` are their fits, once there are any.
    """

    images: ImageRows
    rays: RayRows
    known: dict[str, KnownRows]
    distances: DistanceRows | None
    fiducials: Table | None = None
    fiducial_rays: Table | None = None
    inner_orientations: tuple[InnerOrientation, ...] = ()


def read_folder_tables(folder: Path, toml: BlockToml, findings: Findings) -> FolderTables | None:
    """Every table that block.toml names; None where one cannot be read as a table."""
    columns: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
        "images": ("image {image}", ("image", "camera", *CENTRE_ELEMENTS, *toml.rotation_system.angles), ()),
        "rays": ("point {point} on image {image}", ("image", "point", "x", "y"), ("sx", "sy")),
        "points": ("point {point}", ("point", *COORDINATES), ()),
        "control": ("point {point}", ("point", *COORDINATES, *SIGMAS, "role"), ()),
        "stations": ("image {image}", ("image", *COORDINATES, *SIGMAS), ()),
        "distances": ("distance {from} - {to}", ("from", "to", "distance", "sigma"), ()),
        "fiducials": ("fiducial {fiducial} of camera {camera}", ("camera", "fiducial", "x", "y"), ()),
        "fiducial_rays": ("fiducial {fiducial} on image {image}", ("image", "fiducial", "x", "y"), ()),
    }
    files = toml.tables
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
    names = {"points": rays.points, "control": rays.points, "stations": images.names}
    known = {kind: _known(kind, tables[kind], names[kind], images.table.file) for kind in names if kind in tables}
    distances = _distances(tables["distances"], rays) if "distances" in tables else None
    if len(tables) < len(read):
        return None
    fiducials, fiducial_rays = (tables.get(kind) for kind in FIDUCIAL_TABLES)
    return FolderTables(images, rays.usable(), known, distances, fiducials, fiducial_rays)


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


def _known(kind: str, table: Table, names: Sequence[str], images_file: str) -> KnownRows:
    if kind == "stations":
        known, position = table.text["image"], table.positions("image", names, images_file)
        table.unique("image")
    else:  # a point may be on no image
        known = table.names("point")
        position = positions_of(known, names)
        table.unique("point")
    coordinates = table.numbers(*COORDINATES)
    if kind == "points":
        nothing = np.full_like(coordinates, np.nan)
        return KnownRows(table, tuple(known), position, coordinates, nothing, np.zeros(len(known), bool))
    zero = "give a positive one; [datum] in block.toml holds elements of images" if kind == "stations" else ""
    sigmas = table.sigmas(*SIGMAS, zero=zero)
    for row, k in np.argwhere((sigmas == 0) & np.isnan(coordinates)).tolist():
        cure = f"give {COORDINATES[k]} or leave {SIGMAS[k]} empty"
        table.note(row, f"{SIGMAS[k]} = 0 holds {COORDINATES[k]}, which is not given", cure)
    check = np.zeros(len(known), bool)
    if kind == "control":
        role = table.text["role"]
        check = (role == "check").to_numpy()
        for row in (~role.is_in(ROLES)).arg_true():
            table.note(row, f"role '{role[row]}' is unknown", f"known: {', '.join(ROLES)}")
    return KnownRows(table, tuple(known), position, coordinates, sigmas, check)


def _distances(table: Table, rays: RayRows) -> DistanceRows:
    ends = [table.positions(column, rays.points, rays.table.file) for column in ("from", "to")]
    for row in (table.text["from"] == table.text["to"]).arg_true():
        table.note(row, "both ends are the same point", "correct one of them or drop the row")
    values = table.numbers("distance", needed=True)
    for row in np.flatnonzero(values[:, 0] <= 0).tolist():
        table.note(row, "the distance is not positive", "give a positive one or drop the row")
    sigmas = table.sigmas("sigma", zero="give a positive one", needed=True)
    return DistanceRows(table, np.stack(ends, 1), values, sigmas)
