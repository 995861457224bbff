"""Approximate values from EXIF and XMP of drones and cameras: position, attitude and principal distance.

Position: GPSLatitude, GPSLongitude, GPSAltitude of EXIF, else the packet of DJI. Attitude: the gimbal's yaw, pitch and
roll (attitudes.py). f in px = f35 / 43.27 sqrt(W^2 + H^2) of the focal length for 35 mm film, an
approximate value. Heights of drones without RTK are barometric: their standard deviation is 30 m. A missing hemisphere
is north and east.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.imagery.exif import exif_of
from jaxbundle.imagery.xmp import station_of, xmp_of
from jaxbundle.io.formats.attitudes import rotations_of_gimbal
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.io.formats.ground_control import STATION_SIGMA, Positions
from jaxbundle.io.text_files import UnreadableError, file_bytes

SUFFIXES = (".jpg", ".jpeg", ".tif", ".tiff")
DIAGONAL_35 = 43.27  # mm, of the format of 35 mm film


class Photograph(NamedTuple):
    """Metadata of a photograph; NaN where missing."""

    name: str
    width: int | None
    height: int | None
    focal_length: float
    """Principal distance in px, approximate."""
    position: tuple[float, float, float]
    """Longitude, latitude in degrees on WGS 84, altitude in m as in the metadata."""
    sigmas: tuple[float, float, float]
    """Standard deviations in m: plan, plan, height."""
    gimbal: tuple[float, float, float]
    """Yaw from true north, pitch, roll in degrees."""

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation object_from_image in a system east, north, up at the position of the photograph."""
        return rotations_of_gimbal(np.array([self.gimbal]))[0]


def read_photograph(path: Path) -> Photograph:
    """Reads EXIF and XMP of a photograph.

    Raises: BlockError where the file cannot be read or Pillow is not installed.

    Example: omega, phi, kappa of a photograph straight down, its top to the north, are 0.
    """
    extra("PIL.Image", "reading EXIF of photographs")
    try:
        file_bytes(path, 1)
    except UnreadableError as error:
        raise BlockError([Problem(f"{path.name} {error.what}", error.cure)]) from error
    found, packet = exif_of(path), xmp_of(path)
    width, height = found.size or (None, None)
    f = found.focal_35 / DIAGONAL_35 * float(np.hypot(width, height)) if width and height and found.focal_35 else np.nan
    station, unknown = station_of(found.station, packet), (np.nan, np.nan, np.nan)
    position = unknown if station is None else (station.longitude, station.latitude, station.altitude)
    assumed = (STATION_SIGMA[0], *STATION_SIGMA)
    x, y, z = (own if own > 0 else other for own, other in zip(packet.sigmas, assumed, strict=True))
    return Photograph(path.name, width, height, f, position, (x, y, z), packet.attitude or unknown)


def positions_of_photographs(folder: Path) -> Positions:
    """Reads the positions of all photographs in a folder, as stations in longitude and latitude.

    Raises: BlockError where the folder has no photographs with positions, or Pillow is not installed.
    """
    files = [file for file in sorted(folder.iterdir()) if file.suffix.lower() in SUFFIXES]
    found = [read_photograph(file) for file in files]
    known = [one for one in found if np.isfinite(one.position[:2]).all()]
    if not known:
        what = f"{folder} has {len(files)} photographs, and none has a position"
        raise BlockError([Problem(what, "give a folder with original photographs of the camera, or a geo.txt")])
    findings = []
    if len(known) < len(found):
        what = f"{len(found) - len(known)} of {len(found)} photographs have no position"
        findings.append(Finding(Kind.UNUSED, what, grade=Severity.NOTE))
    plan, height = (max(one.sigmas[k] for one in known) for k in (0, 2))
    words = f"positions of photographs have standard deviations of up to {plan:g} m in plan and {height:g} m in height"
    findings.append(Finding(Kind.INFORMATION, f"{words}; the reference of the altitudes is unknown"))
    stations = tuple(Known(one.name, one.position, one.sigmas) for one in known)
    nothing = (np.nan, np.nan, np.nan)
    attitudes = tuple(Known(one.name, one.gimbal, nothing) for one in known if np.isfinite(one.gimbal).all())
    return Positions(stations, attitudes, "EPSG:4326", tuple(findings))
