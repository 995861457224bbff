"""Reading control, stations and attitudes from additional tables of a foreign block.

    gcp_list.txt     line 1: coordinate system; then x y z u v image [name]      u, v from the centre of the first pixel
    geo.txt          line 1: coordinate system; then image x y [z [yaw pitch roll [sigma_horizontal sigma_vertical]]]
    control.csv      point,X,Y,Z,sX,sY,sZ[,role] with a header, as in a block folder; no image coordinates

x is easting or longitude, y northing or latitude, independent of the axis order of the coordinate system. A point is
identified by its name, without a name by its coordinates. Source: OpenDroneMap's documentation, "Ground Control Points"
and "Image Geolocation Files".
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.io.formats.foreign_block import ForeignBlock, Known, Points, RayTable
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.near_names import nearest
from jaxbundle.io.noted import Noted

CONTROL_SIGMA = (0.05, 0.1)  # m, in plan and height, for tables without sigmas: signalised points measured by GNSS
STATION_SIGMA = (5.0, 30.0)  # m, in plan and height: navigation receivers of cameras, barometric heights
NADIR = 90.0  # deg: this table counts the pitch from the nadir, a gimbal from the horizon
CLOSE = 1.0  # m: two points without names that are closer than this are probably the same point


@dataclass(frozen=True)
class GroundControl:
    """Content of a table of control: points, their rays as (point, image, u, v), and its coordinate system."""

    points: tuple[Known, ...]
    rays: tuple[tuple[str, str, float, float], ...]
    coordinate_system: str
    findings: tuple[Finding, ...] = ()


def read_control(path: Path, sigma: tuple[float, float] | None = None) -> GroundControl:
    """Reads a gcp_list.txt or a table with header, distinguished by the first line.

    `sigma`: standard deviations in plan and height, for a table without them.

    Raises: BlockError with all problems.
    """
    lines = lines_of(path)
    first = next((line for line in lines if line.strip()), "")
    noted = Noted()
    if {"point", "x", "y"} <= set(_columns(first)):
        found = _table(path, lines, noted, sigma)
    else:
        found = _gcp_list(path, lines, noted, sigma)
    if noted:
        raise noted.error()
    if not found.points:
        raise BlockError([Problem(f"{path.name} has no point", "add one row per point or per image point")])
    return found


def _split(line: str) -> list[str]:
    separator = next((mark for mark in (",", ";", "\t") if mark in line), " ")
    return next(csv.reader(io.StringIO(line), delimiter=separator, skipinitialspace=True), [])


def _columns(line: str) -> list[str]:
    """The columns of a header; names of Metashape are accepted: #Label, X/Easting, Y/Northing."""
    fields = [field.strip().lower().lstrip("#").strip() for field in _split(line)]
    names = {"label": "point", "name": "point", "id": "point", "easting": "x", "northing": "y", "altitude": "z"}
    return [names.get(field, field.partition("/")[0] if field[:2] in ("x/", "y/", "z/") else field) for field in fields]


def _gcp_list(path: Path, lines: list[str], noted: Noted, sigma: tuple[float, float] | None) -> GroundControl:
    system, at = _header(lines)
    coordinates: dict[str, tuple[float, float, float]] = {}
    rays: list[tuple[str, str, float, float]] = []
    findings: list[Finding] = []
    for number, line in enumerate(lines[at:], at + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        fields = line.split("\t") if line.count("\t") >= 5 else line.split()
        fields = [field.strip() for field in fields]
        if len(fields) < 6:
            noted.add(path.name, number, f"the row has {len(fields)} fields, not x y z u v image [name]", AGAIN)
            continue
        height = "0" if fields[2].lower() == "nan" else fields[2]
        values = numbers(path, number, [*fields[:2], height, *fields[3:5]], noted)
        if values is None:
            continue
        x, y, z, u, v = values
        place = (x, y, np.nan if fields[2].lower() == "nan" else z)
        name = fields[6] if len(fields) > 6 and fields[6] else f"({fields[0]}, {fields[1]}, {fields[2]})"
        other = coordinates.setdefault(name, place)
        if not np.array_equal(np.array(other), np.array(place), equal_nan=True):
            what = f"point {shown(name)} has two positions, {_shown(other)} and {_shown(place)}; the first is used"
            cure = "give both rows the same coordinates, or other names"
            findings.append(Finding(Kind.INFORMATION, what, cure, grade=Severity.CHECK))
        rays.append((name, fields[5], u + 0.5, v + 0.5))
    findings += _close(coordinates)
    plan, height = sigma or CONTROL_SIGMA
    points = tuple(Known(name, place, (plan, plan, height)) for name, place in coordinates.items())
    if sigma is None and points:
        findings.append(_assumed_sigma(path, plan, height))
    return GroundControl(points, tuple(rays), system, tuple(dict.fromkeys(findings)))


def _header(lines: Sequence[str]) -> tuple[str, int]:
    """The coordinate system and the number of the first row; "" where the first line already is a row."""
    for k, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith("#"):
            fields = line.split()
            try:
                is_row = len(fields) >= 6 and all(np.isfinite(float(field)) or field for field in fields[:2])
            except ValueError:
                is_row = False
            return ("", k) if is_row else (line.strip(), k + 1)
    return "", len(lines)


def _shown(place: tuple[float, float, float]) -> str:
    return " ".join(f"{value:.10g}" for value in place)


def _close(coordinates: dict[str, tuple[float, float, float]]) -> list[Finding]:
    """A finding about points that may be the same, as their coordinates nearly agree."""
    names = list(coordinates)
    values = np.nan_to_num(np.array(list(coordinates.values()), float).reshape(-1, 3))
    if len(names) > 1000 or (np.abs(values[:, :2]) <= 360).all():  # degrees, or too many to compare
        return []
    close = np.argwhere(np.triu(np.linalg.norm(values[:, None] - values[None], axis=2) < CLOSE, 1))
    return [
        Finding(
            Kind.INFORMATION,
            f"control points {names[a]} and {names[b]} lie less than {CLOSE:g} m apart",
            "give their rows the same coordinates if they are one point",
            grade=Severity.CHECK,
        )
        for a, b in close.tolist()
    ]


def _assumed_sigma(path: Path, plan: float, height: float) -> Finding:
    what = f"{path.name} has no standard deviations; assumed are {plan:g} m in plan and {height:g} m in height"
    return Finding(Kind.INFORMATION, what, "give them with --control-sigma")


def _table(path: Path, lines: list[str], noted: Noted, sigma: tuple[float, float] | None) -> GroundControl:
    """Reads a table with a header: point, X, Y, Z and, if present, sX, sY, sZ and role."""
    header: list[str] = []
    points: list[Known] = []
    plan, height = sigma or CONTROL_SIGMA
    assumed = False
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        fields = [field.strip() for field in _split(line)]
        if not header:
            header = _columns(line)
            continue
        row = dict(zip(header, fields, strict=False))
        values = []
        for column, default in (("x", ""), ("y", ""), ("z", ""), ("sx", plan), ("sy", plan), ("sz", height)):
            text = row.get(column, "")
            if not text:
                given = column in header or not default
                assumed |= not given
                values.append(np.nan if given else float(default))
                continue
            value = numbers(path, number, [text], noted, column)
            values.append(value[0] if value else np.nan)
        if not row.get("point"):
            noted.add(path.name, number, "the point has no name", "name it or drop the row")
            continue
        known = Known(row["point"], tuple(values[:3]), tuple(values[3:]), row.get("role", "").lower() == "check")
        points.append(known)
    findings = (_assumed_sigma(path, plan, height),) if assumed else ()
    return GroundControl(tuple(points), (), "", findings)


def with_control(foreign: ForeignBlock, control: GroundControl) -> ForeignBlock:
    """Adds control points and their rays to the block; points with the same names become control points."""
    images = {name: k for k, name in enumerate(foreign.images.names)}
    stems = _stems(foreign.images.names)
    points = {name: k for k, name in enumerate(foreign.points.names)}
    names = [*foreign.points.names, *(row.name for row in control.points if row.name not in points)]
    position = {name: k for k, name in enumerate(names)}
    lost, rows = [], []
    for name, image, u, v in control.rays:
        k = images.get(image, stems.get(Path(image).stem.lower(), -1))
        if k < 0:
            lost.append(image)
        else:
            rows.append((k, position[name], u, v))
    added = np.array(rows, float).reshape(-1, 4)
    coordinates = np.full((len(names), 3), np.nan)
    coordinates[: len(points)] = foreign.points.coordinates
    old = foreign.rays
    sigma = None if old.sigma is None else np.r_[old.sigma, np.full(len(added), foreign.sigma)]
    rays = RayTable(
        np.r_[old.image, added[:, 0].astype(np.int64)],
        np.r_[old.point, added[:, 1].astype(np.int64)],
        np.concatenate([old.xy, added[:, 2:]]),
        sigma,
    )
    findings = list(control.findings)
    if lost:
        distinct = list(dict.fromkeys(lost))
        match = nearest(distinct[:20], foreign.images.names)
        meant = f"; did you mean {next(iter(match.pairs.values()))}?" if match and match.pairs else ""
        what = f"{len(lost)} rays of control are on {len(distinct)} images that are not in the block, such as"
        grade = Severity.CHECK if rows else Severity.FAILED
        cure = f"compare the names of the images{meant}"
        findings.append(Finding(Kind.NOT_USED, f"{what} {distinct[0]}", cure, grade=grade))
    return replace(
        foreign,
        points=Points(tuple(names), coordinates),
        rays=rays,
        control=(*foreign.control, *control.points),
        coordinate_system=control.coordinate_system or foreign.coordinate_system,
        findings=(*foreign.findings, *findings),
    )


def _stems(names: tuple[str, ...]) -> dict[str, int]:
    """Images by their name without folder, extension and case, where that is unique."""
    found: dict[str, int] = {}
    for k, name in enumerate(names):
        stem = Path(name).stem.lower()
        found[stem] = -1 if stem in found else k
    return found


@dataclass(frozen=True)
class Positions:
    """Content of a table of image positions; `attitudes`: yaw, pitch and roll of a gimbal in degrees."""

    stations: tuple[Known, ...]
    attitudes: tuple[Known, ...]
    coordinate_system: str
    findings: tuple[Finding, ...] = ()


def read_positions(path: Path, sigma: tuple[float, float] | None = None) -> Positions:
    """Reads a geo.txt with positions of images.

    Raises: BlockError with all problems.
    """
    noted, lines = Noted(), lines_of(path)
    system, at = next(((line.strip(), k + 1) for k, line in enumerate(lines) if line.strip()), ("", len(lines)))
    stations, attitudes, assumed = [], [], False
    for number, line in enumerate(lines[at:], at + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        fields = line.split("\t") if "\t" in line else line.split()
        fields = [field.strip() for field in fields]
        values = numbers(path, number, fields[1:9], noted) if len(fields) >= 3 else None
        if len(fields) < 3:
            noted.add(path.name, number, f"the row has {len(fields)} fields, not image x y [z ...]", AGAIN)
        if values is None:
            continue
        place = (values[0], values[1], values[2] if len(values) > 2 else np.nan)
        given = (values[6], values[7]) if len(values) > 7 and min(values[6:8]) > 0 else None
        assumed |= given is None
        plan, height = given or sigma or STATION_SIGMA
        stations.append(Known(fields[0], place, (plan, plan, height)))
        if len(values) > 5:
            gimbal = (values[3], values[4] - NADIR, values[5])
            attitudes.append(Known(fields[0], gimbal, (np.nan, np.nan, np.nan)))
    if noted:
        raise noted.error()
    findings = ()
    if assumed and sigma is None:
        plan, height = STATION_SIGMA
        what = f"{path.name} has no standard deviations; assumed are {plan:g} m in plan and {height:g} m in height"
        findings = (Finding(Kind.INFORMATION, what, "give them with --station-sigma"),)
    return Positions(tuple(stations), tuple(attitudes), system, findings)


def with_stations(foreign: ForeignBlock, positions: Positions) -> ForeignBlock:
    """Adds observed projection centres to the block; names of images match without extension and case."""
    stems = _stems(foreign.images.names)
    images = {name: k for k, name in enumerate(foreign.images.names)}

    def named(row: Known) -> Known:
        k = images.get(row.name, stems.get(Path(row.name).stem.lower(), -1))
        return row if k < 0 else row._replace(name=foreign.images.names[k])

    return replace(
        foreign,
        stations=(*foreign.stations, *map(named, positions.stations)),
        attitudes=(*foreign.attitudes, *map(named, positions.attitudes)),
        coordinate_system=foreign.coordinate_system or positions.coordinate_system,
        findings=(*foreign.findings, *positions.findings),
    )
