"""Reading EXIF data of photographs: camera, size, focal length and position."""

import math
from pathlib import Path
from typing import Any, NamedTuple

from jaxbundle.imagery.extra import required
from jaxbundle.imagery.photographs import of_any_size

FULL_FRAME = 36.0  # mm: width of the film that the 35 mm equivalent of a focal length refers to
MAKE, MODEL, EXIF, GPS = 271, 272, 0x8769, 0x8825  # tags and directories (CIPA DC-008)
TIME, FOCAL, FOCAL_35, WIDTH, LENGTH = 36867, 37386, 41989, 40962, 40963
SOUTH, LATITUDE, WEST, LONGITUDE, BELOW, ALTITUDE = 1, 2, 3, 4, 5, 6


class Station(NamedTuple):
    """A position on the ellipsoid of WGS 84."""

    latitude: float
    """deg, north positive."""
    longitude: float
    """deg, east positive."""
    altitude: float
    """m, as recorded by the receiver; NaN if not recorded."""


class ExifData(NamedTuple):
    """EXIF data of a photograph; empty text and None mean missing values."""

    camera: str = ""
    """Maker and model."""
    focal: float | None = None
    """mm."""
    focal_35: float | None = None
    """mm, for the 35 mm equivalent."""
    station: Station | None = None
    time: str = ""
    size: tuple[int, int] | None = None
    """Width and height in px from the EXIF data."""


def exif_of(path: Path) -> ExifData:
    """EXIF data of a JPEG, PNG or TIFF file; empty without EXIF data."""
    module = required("PIL.Image")
    try:
        with of_any_size(module), module.open(path) as image:
            tags = image.getexif()
            details, gps = tags.get_ifd(EXIF), tags.get_ifd(GPS)
    except (OSError, ValueError, SyntaxError):
        return ExifData()
    make, model = (str(tags.get(tag, "")).strip(" \0") for tag in (MAKE, MODEL))
    camera = model if model.startswith(make) else f"{make} {model}".strip()
    time = str(details.get(TIME, "")).strip(" \0")
    focal, focal_35 = _positive(details.get(FOCAL)), _positive(details.get(FOCAL_35))
    width, height = _positive(details.get(WIDTH)), _positive(details.get(LENGTH))
    size = (int(width), int(height)) if width and height else None
    return ExifData(camera, focal, focal_35, _station(gps), time, size)


def _positive(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < 1e5 else None


def _station(gps: dict) -> Station | None:
    try:
        latitude, longitude = (sum(float(x) / 60**k for k, x in enumerate(gps[t])) for t in (LATITUDE, LONGITUDE))
        altitude = float(gps.get(ALTITUDE, math.nan))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    below = gps.get(BELOW, 0) in (1, b"\x01")
    south, west = (str(gps.get(t, "")).startswith(side) for t, side in ((SOUTH, "S"), (WEST, "W")))
    station = Station(
        -latitude if south else latitude, -longitude if west else longitude, -altitude if below else altitude
    )
    empty = station.latitude == station.longitude == 0  # a receiver without a position fix
    return station if not empty and abs(station.latitude) <= 90 and abs(station.longitude) <= 180 else None
