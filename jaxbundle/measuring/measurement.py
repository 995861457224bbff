"""From photographs to a block folder: pyramids, interest points, verified pairs, tracks, rays by matching."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.problems import Problem
from jaxbundle.imagery.exif import Station
from jaxbundle.imagery.image_problems import ImageError
from jaxbundle.imagery.interest_points import NUMBER, empty_places, kept_features
from jaxbundle.imagery.tracks import tracks
from jaxbundle.imagery.windows import GreyImages
from jaxbundle.measuring.control_marks import ControlMarks, marks_of, remeasured
from jaxbundle.measuring.measured_folder import Observed, StationSigmas, write_measured
from jaxbundle.measuring.measured_rays import MeasuredRays, measured_rays
from jaxbundle.measuring.pair_files import FOLDER
from jaxbundle.measuring.photo_set import CameraGiven, PhotoSet, photo_set
from jaxbundle.measuring.stations import stations_of
from jaxbundle.measuring.verify import View, verified_pairs

MIN_RAYS = 12  # minimum rays of an image: with fewer, regions of von Gruber are empty
Told = Callable[[str], None]


class MeasureOptions(NamedTuple):
    """Options of the measurement of photographs.

    Example:
        >>> jb.measuring.MeasureOptions(level=2).level
        2
    """

    level: int = 1
    """Level of the pyramids for the detection of points."""
    number: int = NUMBER
    """Maximum number of points detected in an image."""
    camera: CameraGiven = CameraGiven()
    station_sigmas: StationSigmas = StationSigmas()
    pyramids: Path | None = None
    """Folder of the pyramids; by default in the folder of the photographs."""
    control: Path | None = None
    """Table of control with marks in the photographs, such as gcp_list.txt; the block gets its coordinate system."""
    remeasure: bool = False
    """Whether the marks of the control are remeasured by matching."""
    attitude_sigma: float | None = None
    """Standard deviation in degrees of the attitudes in the XMP data; None: they are not used."""


class Measured(NamedTuple):
    """Result of the measurement of photographs.

    Example:
        >>> jb.measuring.Measured._fields
        ('photos', 'rays', 'stations', 'findings', 'control')
    """

    photos: PhotoSet
    rays: MeasuredRays
    stations: Float[np.ndarray, "image 3"]
    """In m; NaN for images without station. East, north, up from the mean of all, or the system of the control."""
    findings: tuple[Finding, ...]
    control: ControlMarks | None = None


def measure(
    paths: Sequence[str | Path],
    out: str | Path | None = None,
    options: MeasureOptions = MeasureOptions(),  # noqa: B008  an immutable tuple
    *,
    positions: Mapping[str, Station] | None = None,
    tell: Told = lambda what: None,
) -> Measured:
    """Measures tie points in photographs without approximate values, and writes a block folder.

    Args:
        paths: image files of one project.
        out: path of the block folder to write; None writes no folder.
        options: levels, numbers, cameras, accuracy of the stations.
        positions: stations by the names of the images, instead of those of the EXIF and XMP data.
        tell: a function that is called with the name of the current phase.

    Returns: photographs, rays with standard deviations, stations, and findings.

    Raises: ImageError for unusable photographs, or photographs without common points; BlockError for the control.

    Example:
        >>> jb.measuring.measure(sorted(Path("photos").glob("*.jpg")), "block")  # doctest: +SKIP
    """
    tell("image pyramids")
    photos = photo_set([Path(path) for path in paths], options.pyramids, options.camera, positions)
    stations, given = stations_of(photos, options.control)
    marks = None if given is None else marks_of(given, [photo.name for photo in photos.photos])
    views = []
    for photo in photos.photos:
        tell(f"interest points of {photo.name}")
        own = kept_features(photo.pyramid, options.level, options.number)
        rows, columns = photo.pyramid.sizes[0]
        interior = np.array([photos.principal_distances[photo.camera], columns / 2, rows / 2, 1.0, -1.0])
        station = stations[len(views)]
        views.append(View(own, interior, station if np.isfinite(station).all() else None, photo.name))
    finished = photos.photos[0].pyramid.path.parent / FOLDER
    pairs = verified_pairs(views, 2.0**options.level, lambda k, n: tell(f"pair {k} of {n}"), finished)
    if not pairs:
        raise ImageError([Problem("no two images have common points", "give images that overlap by half or more")])
    positions_of_features = [view.features.xy for view in views]
    found = tracks([len(xy) for xy in positions_of_features], pairs)
    tell(f"matching {len(found.image)} rays of {int(found.point.max(initial=-1)) + 1} points")
    greys = GreyImages({k: photo.pyramid for k, photo in enumerate(photos.photos)})
    rays = measured_rays(greys, found, positions_of_features, options.level)
    if marks is not None and options.remeasure:
        tell("matching marks of control")
        marks = remeasured(greys, marks, rays, [photo.pyramid.sizes[0] for photo in photos.photos])
    findings = (*photos.findings, *_judged(photos, rays), *_unused(photos, options), *(marks.findings if marks else ()))
    if out is not None:
        observed = Observed(marks, options.attitude_sigma, given.coordinate_system if given else "")
        write_measured(Path(out), photos, rays, stations, options.station_sigmas, observed=observed)
    return Measured(photos, rays, stations, findings, marks)


def _unused(photos: PhotoSet, options: MeasureOptions) -> list[Finding]:
    """A finding about attitudes without a standard deviation."""
    count = sum(photo.xmp.attitude is not None for photo in photos.photos)
    if not count or options.attitude_sigma is not None:
        return []
    what = f"the attitudes of {count} images are not used, as their standard deviation is not known"
    return [Finding(Kind.INFORMATION, what, "give it with --attitude-sigma, in degrees")]


def _judged(photos: PhotoSet, rays: MeasuredRays) -> list[Finding]:
    """Findings about images without rays, separate parts, and empty regions of von Gruber."""
    count, found = len(photos.photos), []
    number = np.bincount(rays.image, minlength=count)
    for k, photo in enumerate(photos.photos):
        subject, (rows, columns) = (Subject("images", (photo.name,)),), photo.pyramid.sizes[0]
        if number[k] < MIN_RAYS:
            what = f"image {photo.name} has {number[k]} rays"
            found.append(Finding(Kind.PARTS, what, "add images that overlap it, or leave it out", subject))
            continue
        empty = empty_places(rays.xy[rays.image == k], rows, columns)
        if empty:
            what = f"image {photo.name} has no point in {empty} of its 9 regions of von Gruber"
            found.append(Finding(Kind.UNCONTROLLED, what, "check for water, shadow or a missing neighbour", subject))
    size = count + int(rays.point.max(initial=-1)) + 1
    graph = coo_array((np.ones(len(rays.image)), (rays.image, count + rays.point)), (size, size))
    part = connected_components(graph, directed=False)[1][:count][number > 0]
    if len(np.unique(part)) > 1:
        what = f"the images form {len(np.unique(part))} parts without common points"
        found.append(Finding(Kind.PARTS, what, "add the images between them, or adjust the parts separately"))
    return found
