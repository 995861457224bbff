"""Two surveys of the same points: tests of displacements with the covariances of both.

    d = x_b - x_a,   Q = Q_a + Q_b,   s0^2 = (v^T P v_a + v^T P v_b) / (f_a + f_b)
    F = d^T Q^+ d / (h s0^2),   h = rank Q                  congruent if F < F(h, f_a + f_b) (Pelzer 1971)

Surveys without a common system of control are brought to one datum first: b by the similarity that fits its datum
points to those of a, and d and Q by the S-transformation over the same points (Baarda 1973)

    S = I - G (G_D^T G_D)^-1 G_D^T,   d <- S d,   Q <- S Q S^T

where G has the seven directions of a similarity as its columns, and G_D those rows that belong to datum points D. At
first all common points are datum points. As long as they are not congruent, the point with the maximum F is removed,
so that a displaced point does not affect the others. Finally each point is tested with its block of Q, at a level such
that all single tests together have the given level (Sidak 1967).

The observations of both surveys are assumed to be independent. Where both have the same control coordinates, their
errors are the same in both and cancel in d, so that Q is too large and the test conservative.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtr, fdtrc, fdtri

from jaxbundle.block.given import require_a
from jaxbundle.geometry.similarity import similarity
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.covariance import covariance_of
from jaxbundle.statistics.reliability_tables import level_of_one

LEVEL = 0.05
MAX_FULL = 400  # common points whose full covariance is computed: 1200 x 1200 numbers, one solution for each row
MIN_DATUM = 4  # points: fewer leave nothing to test beside the seven parameters of a similarity
RANK = 1e-10  # of the largest eigenvalue: smaller ones are zero
Datum = Literal["common", "similarity"]


class Surveys(NamedTuple):
    """The test of two surveys. Rows are the common points; differences are second minus first, in the common datum.

    Example:
        >>> test = jb.report.survey_congruency(result, result)
        >>> test.names[:3]
        ('A', 'B', 'C')
    """

    names: tuple[str, ...]
    difference: Float[np.ndarray, "point 3"]
    sd: Float[np.ndarray, "point 3"]
    """Standard deviations of the differences, NaN for a coordinate that is fixed in both."""
    statistic: float
    """F of the datum points together, in a similarity datum of all points before any was taken out."""
    freedom: tuple[int, int]
    limit: float
    probability: float
    points: Float[np.ndarray, " point"]
    """F of each single point."""
    point_limit: Float[np.ndarray, " point"]
    moved: Bool[np.ndarray, " point"]
    datum: Datum
    datum_points: tuple[str, ...]
    """Points of the similarity; all common ones if both surveys have the system of their control."""
    full: bool
    """Whether correlations between the points are used."""
    variances: float
    """The probability of so different variances of unit weight, two-sided (F test)."""
    level: float

    @property
    def congruent(self) -> bool:
        """Whether there are no displacements: neither all points together nor a single one exceeds its limit."""
        return self.statistic <= self.limit and not bool(self.moved.any())

    def summary(self) -> str:
        """The test in words, with its levels."""
        verdict = "congruent" if self.congruent else "not congruent"
        moved = [name for name, is_moved in zip(self.names, self.moved, strict=True) if is_moved]
        system = "the system of their control"
        if self.datum == "similarity":
            system = f"a similarity over {len(self.datum_points)} datum points"
        return "\n".join(
            (
                f"The {len(self.names)} common points are {verdict}: F {self.statistic:.4g} of {self.freedom[0]} and"
                f" {self.freedom[1]} degrees of freedom, limit {self.limit:.4g} at a level of {self.level:g},"
                f" p = {self.probability:.2g}.",
                f"Moved points: {len(moved)}" + (f" ({', '.join(moved)})" if moved else "") + ".",
                f"Compared in {system}, correlations between points {'regarded' if self.full else 'neglected'}.",
                f"Variances of unit weight {'differ' if self.variances < self.level else 'agree'}:"
                f" p = {self.variances:.2g}.",
            )
        )


class _Both(NamedTuple):
    """Coordinates of the common points in both surveys, and their cofactors, without sigma0."""

    first: Float[np.ndarray, "point 3"]
    second: Float[np.ndarray, "point 3"]
    of_first: Float[np.ndarray, "coordinate coordinate"]
    of_second: Float[np.ndarray, "coordinate coordinate"]


class _Tested(NamedTuple):
    """Differences and their cofactors in one datum."""

    difference: Float[np.ndarray, " coordinate"]
    cofactors: Float[np.ndarray, "coordinate coordinate"]


def survey_congruency(
    first: Adjustment, second: Adjustment, *, level: float = LEVEL, datum: Datum | None = None
) -> Surveys:
    """Tests whether the points that two independent surveys have in common are the same.

    Args:
        first: a concrete adjustment with standard deviations.
        second: the later one; its observations are independent of those of the first.
        level: probability of an error of the first kind, for all single tests together and for the
            test of all points.
        datum: "common" where both are in the system of the same control, "similarity" to compare shapes only; None
            takes "common" where control gives the datum of both.

    Returns: the test, with differences in the unit of the first survey.

    Raises: TypeError for other objects; ValueError for a level not between 0 and 1, for surveys without
    standard deviations, and for too few common points.

    Example:
        >>> test = jb.report.survey_congruency(result, result)
        >>> test.congruent
        True
    """
    for one in (first, second):
        require_a(Adjustment, one, "report.survey_congruency")
        if one.cofactors is None:
            raise ValueError("a survey has no standard deviations: adjust both with precision=True")
    if not 0 < level < 1:
        raise ValueError(f"the level {level} is not between 0 and 1")
    names, rows = _common(first, second)
    kinds = {one.block.structure.datum.kind for one in (first, second)}
    chosen: Datum = datum or ("common" if kinds == {"control"} else "similarity")
    full = len(names) <= MAX_FULL
    both = _Both(
        *(np.asarray(one.block.object_points)[k] for one, k in zip((first, second), rows, strict=True)),
        *(_cofactors(one, k, full) for one, k in zip((first, second), rows, strict=True)),
    )
    freedom = first.redundancy + second.redundancy
    variance = float(first.vtpv + second.vtpv) / freedom
    everything = np.arange(len(names))
    if chosen == "similarity" and len(names) < MIN_DATUM:
        raise ValueError(f"{len(names)} common points are too few for a similarity: at least {MIN_DATUM} are needed")
    tested = _in_datum(both, everything, chosen)
    statistic, h = _together(tested, everything, variance)
    limit = float(fdtri(h, freedom, 1 - level))
    carriers = _carriers(both, variance, freedom, level) if chosen == "similarity" else everything
    tested = _in_datum(both, carriers, chosen)
    single, ranks = _alone(tested, variance)
    one_level = level_of_one(level, int((ranks > 0).sum()))
    limits = np.where(ranks > 0, fdtri(np.maximum(ranks, 1), freedom, 1 - one_level), np.inf)
    variances = np.diag(tested.cofactors).reshape(-1, 3) * variance
    return Surveys(
        names,
        tested.difference.reshape(-1, 3),
        np.where(variances > 0, np.sqrt(np.maximum(variances, 0.0)), np.nan),
        statistic,
        (h, freedom),
        limit,
        float(fdtrc(h, freedom, statistic)),
        single,
        limits,
        single > limits,
        chosen,
        tuple(names[k] for k in carriers),
        full,
        _same_variances(first, second),
        level,
    )


def _common(first: Adjustment, second: Adjustment) -> tuple[tuple[str, ...], list[Int[np.ndarray, " point"]]]:
    """Names of the points that both have and that are unknown in one of them, and their rows in both."""
    a, b = (one.block.structure for one in (first, second))
    free = [{s.point_names[k] for k in np.flatnonzero(s.point_free.any(1))} for s in (a, b)]
    there, known = set(b.point_names), [{n: k for k, n in enumerate(s.point_names)} for s in (a, b)]
    names = tuple(name for name in a.point_names if name in there and (name in free[0] or name in free[1]))
    if not names:
        raise ValueError("the surveys have no unknown point of the same name")
    return names, [np.array([index[name] for name in names]) for index in known]


def _cofactors(one: Adjustment, rows: Int[np.ndarray, " point"], full: bool) -> Float[np.ndarray, "c c"]:
    count = 3 * len(rows)
    if full and float(one.sigma0) > 0:
        picked = jnp.asarray(rows)
        covariance = covariance_of(one, lambda block: block.object_points[picked]).covariance
        return covariance.reshape(count, count) / float(one.sigma0) ** 2
    assert one.cofactors is not None
    blocks, matrix = np.asarray(one.cofactors.object_points)[rows], np.zeros((count, count))
    for k in range(len(rows)):
        matrix[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = blocks[k]
    return matrix


def _in_datum(both: _Both, carriers: Int[np.ndarray, " carrier"], datum: Datum) -> _Tested:
    """Differences and cofactors; in a similarity datum those of the S-transformation over its carriers."""
    if datum == "common":
        return _Tested((both.second - both.first).ravel(), both.of_first + both.of_second)
    weights = np.zeros(len(both.first))
    weights[carriers] = 1.0
    found = similarity(jnp.asarray(both.second), jnp.asarray(both.first), jnp.asarray(weights)).similarity
    fitted = np.asarray(found(jnp.asarray(both.second)))
    turned = np.kron(np.eye(len(weights)), float(found.scale) * np.asarray(found.rotation))
    cofactors = both.of_first + turned @ both.of_second @ turned.T
    g = _directions(both.first)
    of_carriers = np.repeat(weights, 3)[:, None] * g
    s = np.eye(len(g)) - g @ np.linalg.solve(of_carriers.T @ g, of_carriers.T)
    return _Tested(s @ (fitted - both.first).ravel(), s @ cofactors @ s.T)


def _directions(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "coordinate 7"]:
    """What a small shift, rotation and change of scale does to coordinates: the columns of G."""
    x = points - points.mean(0)
    x = x / max(float(np.abs(x).max()), 1e-300)
    turns = [np.cross(axis, x) for axis in np.eye(3)]
    columns = [np.tile(axis, (len(x), 1)) for axis in np.eye(3)] + turns + [x]
    return np.stack([column.ravel() for column in columns], 1)


def _quadratic(d: Float[np.ndarray, " n"], q: Float[np.ndarray, "n n"]) -> tuple[float, int]:
    """d^T Q^+ d and the rank of Q, by the eigenvalues of the matrix scaled to a unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(q), 0.0))
    there = scale > 0
    if not there.any():
        return 0.0, 0
    values, vectors = np.linalg.eigh(q[np.ix_(there, there)] / np.outer(scale[there], scale[there]))
    usable = values > RANK * values[-1]
    along = vectors[:, usable].T @ (d[there] / scale[there])
    return float((along**2 / values[usable]).sum()), int(usable.sum())


def _together(tested: _Tested, points: Int[np.ndarray, " point"], variance: float) -> tuple[float, int]:
    """F of some points together, and its first degrees of freedom."""
    rows = (3 * points[:, None] + np.arange(3)).ravel()
    value, rank = _quadratic(tested.difference[rows], tested.cofactors[np.ix_(rows, rows)])
    return (value / (rank * variance) if rank else 0.0), rank


def _alone(tested: _Tested, variance: float) -> tuple[Float[np.ndarray, " point"], Int[np.ndarray, " point"]]:
    """F of each single point, and its first degrees of freedom."""
    found = [_together(tested, np.array([k]), variance) for k in range(len(tested.difference) // 3)]
    return np.array([value for value, _ in found]), np.array([rank for _, rank in found])


def _carriers(both: _Both, variance: float, freedom: int, level: float) -> Int[np.ndarray, " carrier"]:
    """The points of the similarity: those that are congruent without the displaced ones."""
    carriers = np.arange(len(both.first))
    while True:
        tested = _in_datum(both, carriers, "similarity")
        value, rank = _together(tested, carriers, variance)
        if not rank or fdtr(rank, freedom, value) <= 1 - level or len(carriers) <= MIN_DATUM:
            return carriers
        alone, _ = _alone(tested, variance)
        carriers = np.delete(carriers, int(np.argmax(alone[carriers])))


def _same_variances(first: Adjustment, second: Adjustment) -> float:
    """The probability of a larger ratio of the variances of unit weight, two-sided."""
    a, b = float(first.sigma0) ** 2, float(second.sigma0) ** 2
    if not (a > 0 and b > 0):
        return float("nan")
    upper = float(fdtrc(first.redundancy, second.redundancy, a / b))
    return 2 * min(upper, 1 - upper)
