"""Radial distortion of a camera with its standard deviation, and correlations of its interior elements."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.known import known
from jaxbundle.report.pictures.ray_pictures import image_format

RADII = 61
METRIC = ("K1", "K2", "K3")  # coefficients of r in mm (Brown 1971)
RELATIVE = ("k1", "k2", "k3")  # coefficients of r over the principal distance


class Distortion(NamedTuple):
    """Radial distortion over the radius, and its a-posteriori standard deviation, all in `unit`."""

    radius: Float[np.ndarray, " radius"]
    distortion: Float[np.ndarray, " radius"]
    sd: Float[np.ndarray, " radius"]
    unit: str


class Correlations(NamedTuple):
    """Correlations of the estimated interior elements of a camera."""

    elements: tuple[str, ...]
    matrix: Float[np.ndarray, "element element"]


def distortion(figures: Figures, camera: int) -> Distortion | None:
    """Radial distortion r (K1 r^2 + K2 r^4 + K3 r^6) of a camera.

    None for a camera model without such coefficients, or a curve that is not finite.
    """
    one, values = figures.structure.cameras[camera], figures.interior[camera]
    place = {name: k for k, name in enumerate(one.model.elements)}
    names = [name for name in (*METRIC, *RELATIVE) if name in place]
    length = next((name for name in ("principal_distance", "f") if name in place), None)
    if not names or length is None:
        return None
    left, low, right, high = image_format(figures, camera)
    size = values[place["pixel_size"]] if one.principal_distance_in_mm and "pixel_size" in place else 1.0
    radius = np.linspace(0.0, 0.5 * np.hypot(right - left, high - low) * size, RADII)
    relative = names[0] in RELATIVE
    scale = values[place[length]] if relative else 1.0
    rows = np.array([radius * (radius / scale) ** (2 * int(name[1])) for name in names])
    columns = [place[name] for name in names]
    sd = np.full(RADII, np.nan)
    cofactors = figures.adjustment.cofactors
    if cofactors is not None:
        q = np.asarray(cofactors.interior)[camera][np.ix_(columns, columns)]
        sd = figures.sigma0 * np.sqrt(np.maximum(np.einsum("ir,ij,jr->r", rows, q, rows), 0.0))
    curve = known(values[columns] @ rows)
    if not (np.isfinite(curve).all() and radius[-1] > 0):
        return None
    return Distortion(radius, curve, known(sd), one.unit_of(length))


def correlations(figures: Figures, camera: int) -> Correlations | None:
    """The correlations of a camera's estimated elements; None where fewer than two are estimated or computed."""
    free = np.flatnonzero(figures.structure.interior_free[camera])
    if figures.adjustment.cofactors is None or len(free) < 2:
        return None
    elements = figures.structure.cameras[camera].model.elements
    matrix = np.asarray(figures.adjustment.interior_correlations)[camera][np.ix_(free, free)]
    return Correlations(tuple(elements[k] for k in free), matrix)
