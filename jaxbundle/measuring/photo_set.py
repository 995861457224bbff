"""The photographs of one measurement: pyramids, cameras and stations, and their problems."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.problems import Problem
from jaxbundle.imagery.exif import FULL_FRAME, ExifData, Station, exif_of
from jaxbundle.imagery.image_problems import ImageError
from jaxbundle.imagery.photographs import photograph
from jaxbundle.imagery.pyramid_file import Pyramid, pyramid, source_hash
from jaxbundle.imagery.xmp import UNKNOWN, XmpData, station_of, xmp_of

BLANK = 2.0  # grey values: standard deviation of an overview below which measurement is impossible
BLURRED = 0.25  # share of the median sharpness of all images
OVERVIEW = 1024  # px: sharpness is computed on the first level not larger than this
COLUMNS = ("image", "latitude", "longitude", "altitude")


class Photo(NamedTuple):
    """One photograph of a measurement."""

    name: str
    path: Path
    pyramid: Pyramid
    exif: ExifData
    camera: str
    """Name of its camera in the block."""
    xmp: XmpData = XmpData()


class PhotoSet(NamedTuple):
    """Photographs, the principal distances of their cameras, and findings."""

    photos: tuple[Photo, ...]
    principal_distances: Mapping[str, float]
    """Principal distances in px, by the name of the camera."""
    findings: tuple[Finding, ...]


class CameraGiven(NamedTuple):
    """Camera data from the user; None means the EXIF data.

    Example:
        >>> jb.measuring.CameraGiven()
        CameraGiven(principal_distance=None, sensor_width=None)
    """

    principal_distance: float | None = None
    """px."""
    sensor_width: float | None = None
    """Sensor width in mm, along the columns of the image."""


def read_positions(path: Path) -> dict[str, Station]:
    r"""Reads stations by the names of their images: a CSV table with image, latitude, longitude (deg), altitude (m).

    Raises: ImageError for a table without these columns or with a field that is not a number.

    Example:
        >>> _ = Path("positions.csv").write_text("image,latitude,longitude,altitude\na.jpg,52.5,13.4,120.0\n")
        >>> jb.measuring.read_positions(Path("positions.csv"))
        {'a.jpg': Station(latitude=52.5, longitude=13.4, altitude=120.0)}
    """
    try:
        table = pl.read_csv(path, infer_schema=False)
    except pl.exceptions.PolarsError as error:
        what = f"is not a table of positions ({str(error).splitlines()[0]})"
        raise ImageError([Problem(what, f"give the columns {', '.join(COLUMNS)}", str(path))]) from error
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        what = f"has no column {', '.join(missing)}"
        raise ImageError([Problem(what, f"give the columns {', '.join(COLUMNS)}", str(path))])
    stations, problems = {}, []
    for row, fields in enumerate(table.select(COLUMNS).iter_rows()):
        try:
            stations[fields[0]] = Station(*(float(field) for field in fields[1:]))
        except (TypeError, ValueError):
            problems.append(Problem(f"image {fields[0]}: a field is not a number", "give numbers", str(path), row + 1))
    if problems:
        raise ImageError(problems)
    return stations


def photo_set(
    paths: Sequence[Path],
    pyramids: Path | None = None,
    given: CameraGiven = CameraGiven(),  # noqa: B008  an immutable tuple
    positions: Mapping[str, Station] | None = None,
) -> PhotoSet:
    """Opens photographs and checks them together.

    Args:
        paths: image files.
        pyramids: folder of the pyramids; by default in the folder of the images.
        given: camera data from the user.
        positions: stations by the names of the images, instead of those of the EXIF and XMP data.

    Raises: ImageError with all problems: unreadable or blank images, duplicates, different sizes in one camera,
        an unknown principal distance.
    """
    _require_distinct(paths)
    photos, problems, found = [], [], []
    for path in paths:
        try:
            made, exif, xmp = pyramid(path, pyramids), exif_of(path), xmp_of(path)
        except FileNotFoundError:
            problems.append(Problem("does not exist", "check the name", str(path)))
            continue
        except ImageError as error:
            problems.extend(error.problems)
            continue
        exif = exif._replace(station=station_of(exif.station, xmp))
        given_station = (positions or {}).get(path.name, (positions or {}).get(path.stem))
        if given_station is not None:
            exif, xmp = exif._replace(station=given_station), xmp._replace(sigmas=UNKNOWN)
        if exif.station is not None and math.isnan(exif.station.altitude):
            exif = exif._replace(station=exif.station._replace(altitude=0.0))
        camera = " ".join([exif.camera or "camera", *([f"{exif.focal:g} mm"] if exif.focal else [])])
        photos.append(Photo(path.name, path, made, exif, camera, xmp))
        if photograph(path).orientation != 1:
            what = f"image {path.name} has an orientation in its EXIF data, which is not applied"
            found.append(_note(path.name, what, "measure coordinates in the stored image"))
    problems += [*_sizes(photos), *_blank(photos)]
    distances = {}
    for photo in photos:
        if photo.camera not in distances:
            distances[photo.camera] = _principal_distance(photo, given)
    problems += [
        Problem("has an unknown principal distance", "give --principal-distance or --sensor-width", f"camera {camera}")
        for camera, distance in distances.items()
        if distance is None
    ]
    if not problems and len(photos) < 2:
        problems.append(Problem("there is one image only", "give at least two that overlap"))
    if problems:
        raise ImageError(problems)
    known = {camera: distance for camera, distance in distances.items() if distance is not None}
    return PhotoSet(tuple(photos), known, tuple(found + _blurred(photos)))


def _note(image: str, what: str, cure: str) -> Finding:
    return Finding(Kind.INFORMATION, what, cure, (Subject("images", (image,)),))


def _require_distinct(paths: Sequence[Path]) -> None:
    problems, names, hashes = [], dict[str, Path](), dict[str, Path]()
    for path in paths:
        if path.name in names:
            what = f"has the name of {names[path.name]}"
            problems.append(Problem(what, "give each image once, with a unique name", str(path)))
        names[path.name] = path
        if path.is_file():
            key = source_hash(path)
            if key in hashes and hashes[key].name != path.name:
                problems.append(Problem(f"is the same image as {hashes[key]}", "give each image once", str(path)))
            hashes[key] = path
    if problems:
        raise ImageError(problems)


def _sizes(photos: Sequence[Photo]) -> list[Problem]:
    first: dict[str, Photo] = {}
    problems = []
    for photo in photos:
        other = first.setdefault(photo.camera, photo)
        (rows, columns), (height, width) = photo.pyramid.sizes[0], other.pyramid.sizes[0]
        if (rows, columns) != (height, width):
            what = f"has {columns} x {rows} px, {other.name} of the same camera {width} x {height} px"
            turned = (rows, columns) == (width, height)
            cure = "use the original image, not a rotated one" if turned else "use the original images of the camera"
            problems.append(Problem(what, cure, str(photo.path)))
    return problems


def _overview(photo: Photo) -> np.ndarray:
    level = next((k for k, size in enumerate(photo.pyramid.sizes) if max(size) <= OVERVIEW), 0)
    return photo.pyramid.grey(level)


def _blank(photos: Sequence[Photo]) -> list[Problem]:
    spreads = [(photo, float(_overview(photo).std())) for photo in photos]
    return [
        Problem(f"is blank: its grey values have a standard deviation of {spread:.1f}", "leave it out", str(photo.path))
        for photo, spread in spreads
        if spread < BLANK
    ]


def _blurred(photos: Sequence[Photo]) -> list[Finding]:
    """Findings about images whose differences of neighbouring grey values are small compared with the others."""
    sharpness = np.array([np.abs(np.diff(_overview(photo), axis=1)).mean() for photo in photos])
    median = float(np.median(sharpness))
    return [
        Finding(
            Kind.INFORMATION,
            f"image {photo.name} is blurred: its neighbouring grey values differ by {own:.2f}, in the median of all"
            f" images by {median:.2f}",
            "leave it out if it has few rays",
            (Subject("images", (photo.name,)),),
            float(own),
        )
        for photo, own in zip(photos, sharpness, strict=True)
        if own < BLURRED * median
    ]


def _principal_distance(photo: Photo, given: CameraGiven) -> float | None:
    """Principal distance in px; from the 35 mm equivalent by the width, or by the longer side of a portrait image."""
    longer = max(photo.pyramid.sizes[0])
    if given.principal_distance is not None:
        return given.principal_distance
    if given.sensor_width is not None and photo.exif.focal is not None:
        return photo.exif.focal / given.sensor_width * photo.pyramid.sizes[0][1]
    if photo.exif.focal_35 is not None and math.isfinite(photo.exif.focal_35):
        return photo.exif.focal_35 / FULL_FRAME * longer
    return None
