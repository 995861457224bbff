"""Writing the block folder of measured photographs: cameras, stations and rays, without orientations."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.io.block_toml import FILE, write_block_toml
from jaxbundle.io.settings import Settings
from jaxbundle.io.tables import Columns, write_table
from jaxbundle.measuring.measured_rays import MeasuredRays
from jaxbundle.measuring.photo_set import PhotoSet

ESTIMATED = ["principal_distance", "x0", "y0", "K1", "K2", "P1", "P2"]
RELATIVE_SIGMA = 0.03  # relative sigma of a principal distance from EXIF data, which is rounded and for another focus
RECEIVER = "receiver"  # the group of stations that share the slowly changing errors of one receiver
ORIENTATION = ("X0", "Y0", "Z0", "omega", "phi", "kappa")


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
) -> None:
    """Writes block.toml, images.csv, rays.csv and, if there are stations, stations.csv.

    Args:
        folder: path of the folder, which is created if missing.
        photos: the photographs.
        rays: rays with indices of photographs as images.
        stations: in m, NaN for images without station.
        station_sigmas: of the observed projection centres.
    """
    names = [photo.name for photo in photos.photos]
    used = np.unique(rays.image)
    empty = np.full(len(used), np.nan)
    tables: dict[str, Columns] = {
        "images": {
            "image": [names[i] for i in used],
            "camera": [photos.photos[i].camera for i in used],
            **dict.fromkeys(ORIENTATION, empty),
        },
        "rays": {
            "image": [names[i] for i in rays.image],
            "point": [str(p + 1) for p in rays.point],
            "x": np.round(rays.xy[:, 0], 4),
            "y": np.round(rays.xy[:, 1], 4),
            "sx": np.round(rays.sigmas[:, 0], 4),
            "sy": np.round(rays.sigmas[:, 1], 4),
        },
    }
    known = used[np.isfinite(stations[used]).all(1)]
    if len(known):
        sigmas = (station_sigmas.horizontal, station_sigmas.horizontal, station_sigmas.vertical)
        tables["stations"] = {
            "image": [names[i] for i in known],
            **{c: np.round(stations[known, k], 4) for k, c in enumerate("XYZ")},
            **{f"s{c}": np.full(len(known), sigma) for c, sigma in zip("XYZ", sigmas, strict=True)},
            "group": [RECEIVER] * len(known),
        }
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
    if len(known):
        settings["navigation"] = {RECEIVER: {"estimate": ["shift"], "priors": {"shift": station_sigmas.shift}}}
    write_block_toml(folder / FILE, Settings.model_validate(settings))


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
