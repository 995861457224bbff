"""Doming: whether differences in height at control and check points have the form of a dome or a bowl."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.vector_pictures import check_vectors, control_vectors


class Dome(NamedTuple):
    """Differences in height over the distance from the centre of the stations, and a fitted curve.

    The curve dZ = level + curvature r^2 is fitted by least squares with equal weights; `sd`: of the curvature.
    """

    radius: Float[np.ndarray, " point"]
    difference: Float[np.ndarray, " point"]
    is_check: Bool[np.ndarray, " point"]
    level: float
    curvature: float
    sd: float


def dome(figures: Figures) -> Dome | None:
    """Fits the curve; None for fewer than three differences, or points at equal distances from the centre."""
    groups = control_vectors(figures), check_vectors(figures)
    position, d = (np.concatenate([getattr(g, name) for g in groups]) for name in ("position", "difference"))
    is_check = np.repeat([False, True], [len(g.names) for g in groups])
    middle = np.nanmean(figures.exterior[:, :2], 0)
    radius = np.hypot(*(position[:, :2] - middle).T)
    usable = np.isfinite(d[:, 2]) & np.isfinite(radius)
    radius, dz, is_check = radius[usable], d[usable, 2], is_check[usable]
    if len(dz) < 3 or not np.ptp(radius) > 1e-6 * radius.max():
        return None
    centred = radius**2 - np.mean(radius**2)
    curvature = float(centred @ dz / (centred @ centred))
    level = float(dz.mean() - curvature * np.mean(radius**2))
    rest = dz - level - curvature * radius**2
    sd = float(np.sqrt(rest @ rest / (len(dz) - 2) / (centred @ centred)))
    return Dome(radius, dz, is_check, level, curvature, sd)
