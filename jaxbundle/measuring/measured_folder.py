"""Writing the block folder of measured photographs: cameras, stations and rays, without orientations."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.io.block_toml import FILE, write_block_toml
from jaxbundle.io.formats.attitudes import observed_attitudes
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.io.settings import Settings
from jaxbundle.io.tables import Columns, write_table
from jaxbundle.measuring.control_marks import MARK_SIGMA, ControlMarks
from jaxbundle.measuring.measured_rays import MeasuredRays
from jaxbundle.measuring.photo_set import PhotoSet

ESTIMATED = ["principal_distance", "x0", "y0", "K1", "K2", "P1", "P2"]
RELATIVE_SIGMA = 0.03  # relative sigma of a principal distance from EXIF data, which is rounded and for another focus
RECEIVER = "receiver"  # the group of stations that share the slowly changing errors of one receiver
ORIENTATION = ("X0", "Y0", "Z0", "omega", "phi", "kappa")


class Observed(NamedTuple):
    """What is observed besides the rays of tie points."""

    control: ControlMarks | None = None
    attitude_sigma: float | None = None
    """Standard deviation of the recorded attitudes in degrees; None: they are not used."""
    system: str = ""
    """Coordinate system of the control; empty for east, north and up."""


class StationSigmas(NamedTuple):
    """Standard deviations of the positions of a receiver without corrections, m.

    Errors of orbits, clocks and the atmosphere change slowly: photographs of one flight share them. Noise and multipath
    of code measurements, of about 1 m (Misra, Enge 2006, Global Positioning System, section 5.3), differ from one
    photograph to the next.
    """

    horizontal: float = 1.0
    vertical: float = 1.5
    shift: float = 5.0
    """Of each component of the shift that all positions share."""


def write_measured(
    folder: Path,
    photos: PhotoSet,
    rays: MeasuredRays,
    stations: Float[np.ndarray, "image 3"],
    station_sigmas: StationSigmas,
    *,
    observed: Observed = Observed(),  # noqa: B008  an immutable tuple
) -> None:
    """Writes block.toml, images.csv, rays.csv and, if observed, stations.csv, attitudes.csv and control.csv.

    Args:
        folder: path of the folder, which is created if missing.
        photos: the photographs.
        rays: rays with indices of photographs as images.
        stations: in m, NaN for images without station.
        station_sigmas: of the observed projection centres, where the photographs do not record their own.
        observed: control and attitudes.
    """
    names, control = [photo.name for photo in photos.photos], observed.control
    used = np.unique(rays.image if control is None else np.concatenate([rays.image, control.image]))
    empty = np.full(len(used), np.nan)
    tables: dict[str, Columns] = {
        "images": {
            "image": [names[i] for i in used],
            "camera": [photos.photos[i].camera for i in used],
            **dict.fromkeys(ORIENTATION, empty),
        },
        "rays": _rays(names, rays, control),
    }
    known = used[np.isfinite(stations[used]).all(1)]
    of_receiver = np.zeros(0, bool)
    if len(known):
        tables["stations"], of_receiver = _stations(photos, known, stations, station_sigmas)
    if control is not None:
        tables["control"] = _control(control)
    attitudes = _attitudes(photos, known, stations, observed)
    if attitudes is not None:
        tables["attitudes"] = attitudes
    folder.mkdir(parents=True, exist_ok=True)
    for kind, columns in tables.items():
        write_table(folder / f"{kind}.csv", columns)
    cameras = {name: _camera(photos, name) for name in dict.fromkeys(photos.photos[i].camera for i in used)}
    settings = {
        "format": 1,
        "name": folder.resolve().name,
        "source": f"{len(names)} photographs, measured by jaxbundle",
        "units": {"object": "m", "angle": "deg"},
        "rotation": {"system": "omega-phi-kappa"},
        "cameras": cameras,
        "sigma": {"image": 0.5},
        "tables": {kind: f"{kind}.csv" for kind in tables},
    }
    if of_receiver.any():
        settings["navigation"] = {RECEIVER: {"estimate": ["shift"], "priors": {"shift": station_sigmas.shift}}}
    write_block_toml(folder / FILE, Settings.model_validate(settings))


def _rays(names: list[str], rays: MeasuredRays, control: ControlMarks | None) -> Columns:
    points = [str(p + 1) for p in rays.point]
    images, xy, sigmas = [names[i] for i in rays.image], rays.xy, rays.sigmas
    if control is not None:
        given = {point.name for point in control.points}
        points = [f"tie-{name}" for name in points] if given & set(points) else points
        points += [control.points[p].name for p in control.point]
        images += [names[i] for i in control.image]
        xy = np.concatenate([xy, control.xy])
        sigmas = np.concatenate([sigmas, np.full_like(control.xy, MARK_SIGMA)])
    values = np.round(np.concatenate([xy, sigmas], 1), 4)
    return {"image": images, "point": points, **{c: values[:, k] for k, c in enumerate(("x", "y", "sx", "sy"))}}


def _stations(
    photos: PhotoSet, known: Int[np.ndarray, " known"], stations: Float[np.ndarray, "image 3"], sigmas: StationSigmas
) -> tuple[Columns, Bool[np.ndarray, " known"]]:
    """The table, and which stations have no standard deviations of their own: they share the shift of a receiver."""
    own = np.array([photos.photos[i].xmp.sigmas for i in known])
    without = np.logical_not(np.all((own > 0) & np.isfinite(own), axis=1))
    own[without] = sigmas.horizontal, sigmas.horizontal, sigmas.vertical
    columns: Columns = {
        "image": [photos.photos[i].name for i in known],
        **{c: np.round(stations[known, k], 4) for k, c in enumerate("XYZ")},
        **{f"s{c}": own[:, k] for k, c in enumerate("XYZ")},
        "group": [RECEIVER if missing else "" for missing in without],
    }
    return columns, without


def _control(control: ControlMarks) -> Columns:
    coordinates = np.array([point.coordinates for point in control.points]).reshape(-1, 3)
    sigmas = np.array([point.sigmas for point in control.points]).reshape(-1, 3)
    sigmas = np.where(np.isfinite(coordinates) & np.isfinite(sigmas), sigmas, np.nan)
    return {
        "point": [point.name for point in control.points],
        **{c: coordinates[:, k] for k, c in enumerate("XYZ")},
        **{f"s{c}": sigmas[:, k] for k, c in enumerate("XYZ")},
        "role": ["check" if point.check else "control" for point in control.points],
    }


def _attitudes(
    photos: PhotoSet, known: Int[np.ndarray, " known"], stations: Float[np.ndarray, "image 3"], observed: Observed
) -> Columns | None:
    """Observations of omega, phi and kappa from the attitudes of the photographs with stations."""
    given = [(photos.photos[i], stations[i]) for i in known if photos.photos[i].xmp.attitude is not None]
    if observed.attitude_sigma is None or not given:
        return None
    nothing = (np.nan, np.nan, np.nan)
    places = tuple(Known(photo.name, (float(x), float(y), float(z)), nothing) for photo, (x, y, z) in given)
    recorded = tuple(Known(photo.name, photo.xmp.attitude or nothing, nothing) for photo, _ in given)
    rows = observed_attitudes(recorded, places, observed.system, observed.attitude_sigma)
    angles = np.degrees([row.coordinates for row in rows])
    return {
        "image": [row.name for row in rows],
        **{c: np.round(angles[:, k], 6) for k, c in enumerate(ORIENTATION[3:])},
        **{f"s{c}": np.full(len(rows), observed.attitude_sigma) for c in ORIENTATION[3:]},
    }


def _camera(photos: PhotoSet, name: str) -> dict[str, Any]:
    photo = next(photo for photo in photos.photos if photo.camera == name)
    rows, columns = photo.pyramid.sizes[0]
    distance = round(photos.principal_distances[name], 3)
    return {
        "image_unit": "px",
        "width": columns,
        "height": rows,
        "principal_distance": distance,
        "principal_point": [columns / 2, rows / 2],
        "distortion": "metashape",
        "estimate": ESTIMATED,
        "priors": {"principal_distance": round(RELATIVE_SIGMA * distance, 3)},
    }
