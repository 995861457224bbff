"""The photographs of one measurement: their pyramids, cameras and stations, and what is wrong with them together."""

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

BLANK = 2.0  # grey values: standard deviation of an overview below which nothing can be measured
BLURRED = 0.25  # of the median sharpness of all images
OVERVIEW = 1024  # px: the level that sharpness is judged on is the first one not larger than this
COLUMNS = ("image", "latitude", "longitude", "altitude")


class Photo(NamedTuple):
    """One photograph."""

    name: str
    path: Path
    pyramid: Pyramid
    exif: ExifData
    camera: str
    """Name of its camera in the block."""


class PhotoSet(NamedTuple):
    """Photographs, the principal distances of their cameras, and what was found."""

    photos: tuple[Photo, ...]
    principal_distances: Mapping[str, float]
    """px, by the name of the camera."""
    findings: tuple[Finding, ...]


class CameraGiven(NamedTuple):
    """What the user says of the camera; None where the EXIF data shall say it.

    Example:
        >>> jb.measuring.CameraGiven()
        CameraGiven(principal_distance=None, sensor_width=None)
    """

    principal_distance: float | None = None
    """px."""
    sensor_width: float | None = None
    """mm, of the columns of the image."""


def read_positions(path: Path) -> dict[str, Station]:
    """Stations by the names of their images: a CSV table with image, latitude, longitude (deg), altitude (m).

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
    """Opens photographs and judges them together.

    Args:
        paths: image files.
        pyramids: folder of the pyramids; beside the images if it is not given.
        given: what the user says of the camera.
        positions: stations by the names of the images, in place of those of the EXIF data.

    Raises: ImageError with all that is wrong: unreadable or blank images, duplicates, sizes that differ in one camera,
        an unknown principal distance.
    """
    _require_distinct(paths)
    photos, problems, found = [], [], []
    for path in paths:
        try:
            made, exif = pyramid(path, pyramids), exif_of(path)
        except FileNotFoundError:
            problems.append(Problem("does not exist", "check the name", str(path)))
            continue
        except ImageError as error:
            problems.extend(error.problems)
            continue
        if positions is not None:
            exif = exif._replace(station=positions.get(path.name, positions.get(path.stem, exif.station)))
        camera = " ".join([exif.camera or "camera", *([f"{exif.focal:g} mm"] if exif.focal else [])])
        photos.append(Photo(path.name, path, made, exif, camera))
        if photograph(path).orientation != 1:
            what = f"image {path.name} has an orientation in its EXIF data, which is not applied"
            found.append(_note(path.name, what, "measure coordinates in the image as it is stored"))
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
            problems.append(Problem(what, "give every image once, under a name of its own", str(path)))
        names[path.name] = path
        if path.is_file():
            key = source_hash(path)
            if key in hashes and hashes[key].name != path.name:
                problems.append(Problem(f"is the same image as {hashes[key]}", "give every image once", str(path)))
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
            cure = "store it as the camera took it, not turned" if turned else "give images as the camera took them"
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
    """Images whose differences of neighbours are small against those of the others."""
    sharpness = np.array([np.abs(np.diff(_overview(photo), axis=1)).mean() for photo in photos])
    median = float(np.median(sharpness))
    return [
        Finding(
            Kind.INFORMATION,
            f"image {photo.name} is blurred: its neighbouring grey values differ by {own:.2f}, in the median of all"
            f" images by {median:.2f}",
            "leave it out if its rays are few",
            (Subject("images", (photo.name,)),),
            float(own),
        )
        for photo, own in zip(photos, sharpness, strict=True)
        if own < BLURRED * median
    ]


def _principal_distance(photo: Photo, given: CameraGiven) -> float | None:
    """px; of the 35 mm equivalent by the width, or by the longer side of an image that stands upright."""
    longer = max(photo.pyramid.sizes[0])
    if given.principal_distance is not None:
        return given.principal_distance
    if given.sensor_width is not None and photo.exif.focal is not None:
        return photo.exif.focal / given.sensor_width * photo.pyramid.sizes[0][1]
    if photo.exif.focal_35 is not None and math.isfinite(photo.exif.focal_35):
        return photo.exif.focal_35 / FULL_FRAME * longer
    return None
