"""Coordinate reference systems of control and positions: geographic coordinates become metric without guessing.

A system is given as EPSG code, WKT, PROJ string, or in the form of OpenDroneMap: "WGS84 UTM 17N" and "WGS84".
Geographic coordinates are transformed to the UTM zone of their mean. Heights are unchanged, since these files do not
define their reference. Approximate transformations between systems are never used (`allow_ballpark=False`).
"""

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxbundle.block.findings import Finding, Kind
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.io.formats.ground_control import GroundControl, Positions

UTM = re.compile(r"WGS\s*84\s+UTM\s+(\d{1,2})\s*([NS])", re.IGNORECASE)
GEOGRAPHIC = re.compile(
    r"^(WGS\s*84|EPSG:4326|EPSG:4979)$|\+proj=(longlat|latlong)|^\s*GEOG(CS|CRS|RAPHICCRS)", re.IGNORECASE
)


def is_geographic(text: str) -> bool:
    """Whether coordinates of a system are longitude and latitude in degrees."""
    text = text.strip()
    if GEOGRAPHIC.search(text):
        return True
    if not text or UTM.search(text) or "+proj=utm" in text or not re.match(r"^(EPSG:\d+|[A-Z]+\[|\+proj)", text):
        return False
    if re.match(r"^(PROJCS|PROJCRS|LOCAL_CS|ENGCRS|ENGINEERINGCRS)", text, re.IGNORECASE):
        return False
    return bool(crs_of(text).is_geographic)


def is_geocentric(text: str) -> bool:
    """Whether coordinates of a system are geocentric X, Y, Z."""
    return text.strip().upper().startswith(("GEOCCS", "GEODCRS")) or text.strip() == "EPSG:4978"


def is_metric_local(text: str) -> bool:
    """Whether a system is local: no transformation relates it to the earth."""
    return text.strip().upper().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS", "LOCAL")) or not text.strip()


def crs_of(text: str) -> Any:
    """The pyproj CRS of a text.

    Raises: BlockError where pyproj does not know it.
    """
    pyproj = extra("pyproj", f"the coordinate system {shown(text)}")
    utm = UTM.search(text)
    code = text
    if utm:
        code = f"EPSG:{32600 + int(utm[1]) + (100 if utm[2].upper() == 'S' else 0)}"
    elif re.fullmatch(r"WGS\s*84", text.strip(), re.IGNORECASE):
        code = "EPSG:4326"
    try:
        return pyproj.CRS.from_user_input(code.strip())
    except pyproj.exceptions.CRSError as error:
        cure = "give EPSG:n, WKT, a PROJ string, or WGS84 UTM 17N"
        raise BlockError([Problem(f"the coordinate system '{shown(text)}' is unknown", cure)]) from error


def transformed(source: str, target: str, coordinates: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    """Coordinates in another system, x east or longitude first; heights change only if both systems define them.

    Raises: BlockError where there is no exact transformation, such as for a missing grid of a geoid.
    """
    pyproj = extra("pyproj", "a transformation of coordinates")
    one, other = crs_of(source), crs_of(target)
    try:
        transformer = pyproj.Transformer.from_crs(one, other, always_xy=True, allow_ballpark=False)
        heights = np.nan_to_num(coordinates[:, 2])
        x, y, z = transformer.transform(coordinates[:, 0], coordinates[:, 1], heights, errcheck=True)
    except pyproj.exceptions.ProjError as error:
        cure = "install the grids that PROJ asks for (projsync), or transform the table before"
        raise BlockError([Problem(f"{shown(source)} to {shown(target)}: {shown(str(error), 200)}", cure)]) from error
    z = np.where(np.isnan(coordinates[:, 2]), np.nan, z)
    found = np.column_stack([x, y, z])
    if not np.isfinite(found[:, :2]).all():
        cure = "check that x is longitude or easting and y latitude or northing, in the units of the system"
        raise BlockError([Problem(f"coordinates are outside the area of {shown(target)}", cure)])
    return found


def utm_zone(longitude: float, latitude: float) -> str:
    """The EPSG code of the UTM zone on WGS 84 of a position in degrees.

    Example: utm_zone(13.4, 52.5) is "EPSG:32633".
    """
    zone = int(math.floor((longitude + 180) / 6)) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0 else 32700) + zone}"


def metric(control: GroundControl | None, positions: Positions | None) -> tuple[GroundControl | None, Positions | None]:
    """Control and positions in one metric system: the system of projected control, else UTM for coordinates in degrees.

    Raises: BlockError where a geographic table has no degrees, or a system is unknown.
    """
    systems = [table.coordinate_system for table in (control, positions) if table is not None]
    texts = [text for text in systems if text]
    if len(set(texts)) < 2 and not any(map(is_geographic, texts)):
        return control, positions
    target = next((text for text in texts if not is_geographic(text)), "")
    rows = (*(control.points if control else ()), *(positions.stations if positions else ()))
    if not target:
        places = np.array([row.coordinates[:2] for row in rows])
        _require_degrees(rows)
        target = utm_zone(*places.mean(0))
    if control is not None:
        points, note = _changed(control.points, control.coordinate_system, target)
        control = dataclasses.replace(
            control, points=points, coordinate_system=target, findings=(*control.findings, *note)
        )
    if positions is not None:
        stations, note = _changed(positions.stations, positions.coordinate_system, target)
        positions = dataclasses.replace(
            positions, stations=stations, coordinate_system=target, findings=(*positions.findings, *note)
        )
    return control, positions


def _require_degrees(rows: Sequence[Known]) -> None:
    wrong = [row.name for row in rows if not (abs(row.coordinates[0]) <= 180 and abs(row.coordinates[1]) <= 90)]
    if wrong:
        what = f"{len(wrong)} rows have no longitude and latitude in degrees, such as {shown(wrong[0])}"
        cure = "give the longitude first, then the latitude, or correct the coordinate system of the first line"
        raise BlockError([Problem(what, cure)])


def _changed(rows: tuple[Known, ...], source: str, target: str) -> tuple[tuple[Known, ...], tuple[Finding, ...]]:
    """Rows in another system, and a finding about the transformation."""
    if not rows or not source or source == target:
        return rows, ()
    if is_geographic(source):
        _require_degrees(rows)
    places = np.array([row.coordinates for row in rows], float)
    found = transformed(source, target, places)
    what = f"coordinates were transformed from {shown(source)} to {shown(target)}; heights are unchanged"
    if np.nanmax(np.abs(np.nan_to_num(found[:, 2] - places[:, 2])), initial=0.0) > 0:
        what = (
            f"coordinates were transformed from {shown(source)} to {shown(target)}, heights as both systems define them"
        )
    changed = tuple(row._replace(coordinates=tuple(place)) for row, place in zip(rows, found.tolist(), strict=True))
    return changed, (Finding(Kind.INFORMATION, what),)


def convergence(text: str, coordinates: Float[np.ndarray, "image 3"]) -> Float[np.ndarray, " image"]:
    """Meridian convergence in radians at positions in a projected system: grid azimuth = azimuth - convergence."""
    pyproj = extra("pyproj", "the meridian convergence")
    crs = crs_of(text)
    geodetic = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    longitude, latitude = geodetic.transform(coordinates[:, 0], coordinates[:, 1])
    factors = pyproj.Proj(crs).get_factors(longitude, latitude)
    return np.radians(np.asarray(factors.meridian_convergence))
