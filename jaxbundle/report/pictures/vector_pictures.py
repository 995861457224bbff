"""Differences at control and check points: adjusted - observed or known, with expected values.

    control    v of the observed coordinates, their sigma a priori, |w| / sigma0: internal, used in the adjustment
    check      adjusted - known, the predicted sd, t = difference / sd: external, not used in the adjustment

Check points test the precision externally: sum t^2 is chi-square distributed, with one degree of freedom for each
difference, if errors are normal and correlations between the points are small.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.diagnosis.points import check_point_ratios
from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.known import known, root_mean_square

CE90, LE90 = 1.5175, 1.6449  # ratios of CE90 and LE90 to the rms of a normal error (ASPRS 2015)


class Vectors(NamedTuple):
    """Points with differences and their expected sizes.

    `expected`: sigma of control, predicted sd of check points. `ratio`: |w| / sigma0 of control, t of check points. NaN
    where not observed or not known.
    """

    names: tuple[str, ...]
    position: Float[np.ndarray, "point 3"]
    difference: Float[np.ndarray, "point 3"]
    expected: Float[np.ndarray, "point 3"]
    ratio: Float[np.ndarray, "point 3"]


class Spread(NamedTuple):
    """Statistics of differences, for each coordinate."""

    number: tuple[int, ...]
    rms: tuple[float, ...]
    mean: tuple[float, ...]
    largest: tuple[float, ...]
    expected: tuple[float, ...]


def control_vectors(figures: Figures) -> Vectors:
    """Residuals of the observed coordinates of control points."""
    tables = [table for table in figures.tables if table.name == CONTROL.name]
    if not tables:
        return _nothing()
    table, names = tables[0], tables[0].who["point"]
    index = rows_of(names, figures.structure.point_names)
    position = known(figures.points[[index[name] for name in names]])
    sizes = table.normalised if np.isnan(table.w).all() else table.w
    scale = figures.sigma0 if figures.sigma0 > 0 else np.inf
    return Vectors(tuple(names), position, known(table.residuals), known(table.sigmas), known(np.abs(sizes) / scale))


def check_vectors(figures: Figures) -> Vectors:
    """Differences at check points."""
    structure, check = figures.structure, figures.structure.check_point
    if not len(check):
        return _nothing()
    differences = known(figures.check_differences)
    ratio = np.full(differences.shape, np.nan)
    if figures.adjustment.cofactors is not None:
        ratio = known(check_point_ratios(figures.adjustment))
    with np.errstate(all="ignore"):
        expected = known(np.abs(differences / ratio))
    sd = known(figures.points_sd[check])
    expected = np.where(np.isfinite(expected), expected, np.where(np.isfinite(differences), sd, np.nan))
    names = tuple(structure.point_names[p] for p in check)
    return Vectors(names, known(figures.points[check]), differences, expected, ratio)


def rows_of(names: Iterable[str], every: Sequence[str]) -> dict[str, int]:
    """Indices of some names among all of them."""
    wanted = set(names)
    return {name: k for k, name in enumerate(every) if name in wanted}


def _nothing() -> Vectors:
    return Vectors((), *(np.zeros((0, 3)) for _ in range(4)))


def spread(vectors: Vectors) -> Spread:
    """Number, root mean square, mean and maximum of the differences in X, Y and Z, and the expected rms."""
    columns = []
    for d, sd in zip(vectors.difference.T, vectors.expected.T, strict=True):
        there = d[np.isfinite(d)]
        mean = float(there.mean()) if len(there) else np.nan
        largest = float(np.abs(there).max()) if len(there) else np.nan
        columns.append((len(there), root_mean_square(there), mean, largest, root_mean_square(sd[np.isfinite(d)])))
    return Spread(*(tuple(column) for column in zip(*columns, strict=True)))


def external_test(vectors: Vectors) -> tuple[float, int, float]:
    """Sum of t^2 of check points, its degrees of freedom, and the probability of a larger one by chance."""
    t = vectors.ratio[np.isfinite(vectors.ratio)]
    total = float((t**2).sum())
    return total, len(t), float(chdtrc(len(t), total)) if len(t) else float("nan")


def arrow_factor(vectors: list[Vectors], extent: float) -> float:
    """The common factor of all arrows, 1, 2 or 5 times 10^k: the longest is an eighth of the extent of the block."""
    lengths = [np.abs(v.difference).max(initial=0.0, where=np.isfinite(v.difference)) for v in vectors]
    longest = max(lengths, default=0.0)
    if not (longest > 0 and extent > 0):
        return 1.0
    power = 10.0 ** np.floor(np.log10(extent / 8 / longest))
    return float(max(step * power for step in (1, 2, 5) if step * power <= extent / 8 / longest * (1 + 1e-12)))
