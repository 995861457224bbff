"""Stations of photographs in metres: about their mean, or in the coordinate system of the control."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.geometry.topocentric import topocentric
from jaxbundle.io.formats.coordinates import metric
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.io.formats.ground_control import GroundControl, Positions, read_control
from jaxbundle.measuring.photo_set import PhotoSet


def stations_of(photos: PhotoSet, control: Path | None) -> tuple[Float[np.ndarray, "image 3"], GroundControl | None]:
    """Stations in m, and the control in the same system.

    Args:
        photos: photographs with latitude, longitude and altitude, or without.
        control: path of a table of control; None: east, north and up about the mean of the stations.

    Returns: the stations, NaN where they are not known. If the table names no coordinate system, none is known in it.

    Raises: BlockError for a table that cannot be read.
    """
    given = np.array([photo.exif.station or (np.nan,) * 3 for photo in photos.photos])
    known = np.flatnonzero(np.isfinite(given).all(1))
    if control is None:
        if not len(known):
            return given, None
        origin = np.nanmean(given, 0)
        origin[2] = 0.0  # heights are those of the receiver
        return topocentric(given, origin), None
    table, stations = read_control(control), np.full(given.shape, np.nan)
    if not table.coordinate_system or not len(known):
        return stations, metric(table, None)[0]
    nothing = (np.nan, np.nan, np.nan)
    places = tuple(
        Known(photos.photos[k].name, (float(given[k, 1]), float(given[k, 0]), float(given[k, 2])), nothing)
        for k in known
    )
    table, positions = metric(table, Positions(places, (), "EPSG:4326"))
    assert positions is not None, "it was given"
    stations[known] = [row.coordinates for row in positions.stations]
    return stations, table
