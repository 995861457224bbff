"""Reading XMP packets of photographs: position, attitude and standard deviations that drones and cameras record.

A packet is text with attributes or elements, named by a prefix and a name. The names are those of DJI and of the camera
schema of Pix4D. Attitudes are yaw from true north (clockwise), pitch (0 level, -90 down) and roll of the gimbal.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

from jaxbundle.imagery.exif import Station
from jaxbundle.imagery.extra import required
from jaxbundle.imagery.photographs import of_any_size

NUMBER = r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
YAW = ("drone-dji:GimbalYawDegree", "Camera:Yaw")
PITCH = ("drone-dji:GimbalPitchDegree", "Camera:Pitch")
ROLL = ("drone-dji:GimbalRollDegree", "Camera:Roll")
LATITUDE = ("drone-dji:Latitude", "drone-dji:GpsLatitude")
LONGITUDE = ("drone-dji:Longitude", "drone-dji:GpsLongitude", "drone-dji:GpsLongtitude")  # the last one as written
ALTITUDE = ("drone-dji:AbsoluteAltitude",)
SIGMAS = ("drone-dji:RtkStdLon", "drone-dji:RtkStdLat", "drone-dji:RtkStdHgt")
SIGMA_PLAN, SIGMA_HEIGHT = ("Camera:GPSXYAccuracy",), ("Camera:GPSZAccuracy",)
UNKNOWN = (math.nan, math.nan, math.nan)


class XmpData(NamedTuple):
    """XMP data of a photograph; None and NaN mean missing values."""

    station: Station | None = None
    attitude: tuple[float, float, float] | None = None
    """Yaw, pitch and roll in degrees."""
    sigmas: tuple[float, float, float] = UNKNOWN
    """Standard deviations of the position towards east, north and up, m."""


def xmp_of(path: Path) -> XmpData:
    """XMP data of a JPEG, PNG or TIFF file; empty without a packet."""
    module = required("PIL.Image")
    try:
        with of_any_size(module), module.open(path) as image:
            packet = image.info.get("xmp", image.info.get("XML:com.adobe.xmp", b""))
    except (OSError, ValueError, SyntaxError):
        return XmpData()
    return xmp_data(packet if isinstance(packet, str) else bytes(packet).decode("utf-8", "replace"))


def xmp_data(packet: str) -> XmpData:
    """Position, attitude and standard deviations of the text of a packet."""

    def number(names: tuple[str, ...]) -> float:
        for name in names:
            found = re.search(rf'{name}\s*(?:=\s*["\']|>)\s*({NUMBER})', packet)
            if found:
                return float(found[1])
        return math.nan

    latitude, longitude, altitude = map(number, (LATITUDE, LONGITUDE, ALTITUDE))
    attitude = (number(YAW), number(PITCH), number(ROLL))
    east, north, up = (number((name,)) for name in SIGMAS)
    if not all(0 < value < math.inf for value in (east, north, up)):
        plan = number(SIGMA_PLAN)
        east, north, up = plan, plan, number(SIGMA_HEIGHT)
    return XmpData(
        _fix(Station(latitude, longitude, altitude)),
        attitude if all(map(math.isfinite, attitude)) else None,
        (east, north, up),
    )


def station_of(exif: Station | None, xmp: XmpData) -> Station | None:
    """The position of the EXIF data, else of the packet; a missing altitude is that of the packet."""
    if exif is None:
        return xmp.station
    if math.isfinite(exif.altitude) or xmp.station is None:
        return exif
    return exif._replace(altitude=xmp.station.altitude)


def _fix(station: Station) -> Station | None:
    """The position, or None where it is missing or that of a receiver without a position fix."""
    known = abs(station.latitude) <= 90 and abs(station.longitude) <= 180
    return station if known and (station.latitude, station.longitude) != (0, 0) else None
