"""Comparing two results of one block, or two surveys of the same points: differences, standard deviations, tests.

    t = (b - a) / sqrt(s_a^2 + s_b^2)           for each unknown of both results

Two results from the same observations are correlated: then t measures the effect of a change of settings or data, in
units of standard deviations. Two independent surveys are tested for congruency (Pelzer 1971; Niemeier 2008): without
displacements the sum of t^2 over all coordinates is chi-square distributed. Single points are tested at a level such
that all tests together have the given level (Sidak 1967). Correlations between points are neglected, as they are not
part of the results. Both surveys must have the same datum.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtrc, chdtri

from jaxbundle.statistics.reliability_tables import level_of_one

TABLES = ("points", "images", "cameras", "parameters")
TOLD = (
    ("program", "program"),
    ("status", "status"),
    ("datum", "datum"),
    ("observations", "observations"),
    ("unknowns", "unknowns"),
    ("redundancy", "redundancy"),
    ("sigma0", "sigma0"),
    ("vtPv", "vTPv"),
    ("method", "method"),
    ("stopping_rule", "stopping rule"),
    ("rotation", "rotation"),
)
LEVEL = 0.05


class Differences(NamedTuple):
    """Differences of the common rows of one table, second minus first.

    `t`: divided by their standard deviations, NaN where these are unknown. `only`: numbers of rows in only the first
    and only the second result.
    """

    table: str
    names: tuple[str, ...]
    columns: tuple[str, ...]
    difference: Float[np.ndarray, "row column"]
    sd: Float[np.ndarray, "row column"]
    ratio: Float[np.ndarray, "row column"]
    only: tuple[int, int]


class Comparison(NamedTuple):
    """Comparison of two results: names, differing and equal facts, and the differences of the unknowns."""

    names: tuple[str, str]
    facts: tuple[tuple[str, str, str], ...]
    findings: tuple[tuple[str, ...], tuple[str, ...]]
    """Findings in only the first, and in only the second result."""
    differences: tuple[Differences, ...]
    unit: str


class Congruency(NamedTuple):
    """The test whether the points of two surveys are the same.

    `statistic`: sum of t^2 over `freedom` coordinates; `limit`: its limit at `level`. `points`: sums of single points,
    with their common limit `point_limit`.
    """

    statistic: float
    freedom: int
    limit: float
    probability: float
    level: float
    points: Float[np.ndarray, " point"]
    point_limit: Float[np.ndarray, " point"]
    moved: Bool[np.ndarray, " point"]

    @property
    def congruent(self) -> bool:
        """Whether there are no displacements: neither the sum of all points nor a single point exceeds its limit."""
        return self.statistic <= self.limit and not self.moved.any()


def compare_reports(first: Mapping[str, Any], second: Mapping[str, Any]) -> Comparison:
    """Compares two results, each as a dictionary of `report_dict` or report.json.

    Raises: ValueError where they have different units, or nothing in common.

    Example:
        >>> report = jb.report.report_dict(result)
        >>> jb.report.compare_reports(report, report).unit
        'm'
    """
    if first["units"] != second["units"]:
        raise ValueError(f"the results have different units: {first['units']} and {second['units']}")
    tables = tuple(_differences(name, first.get(name, {}), second.get(name, {})) for name in TABLES)
    tables = tuple(table for table in tables if table.names)
    if not tables:
        raise ValueError("the results have no point, image or camera with the same name")
    facts = [(label, _words(first.get(key)), _words(second.get(key))) for key, label in TOLD]
    facts += _changed_inputs(first, second)
    said = [{_finding(f): None for f in data.get("findings", ())} for data in (first, second)]
    alone = tuple(tuple(words for words in mine if words not in other) for mine, other in (said, said[::-1]))
    names = first.get("name") or "(unnamed)", second.get("name") or "(unnamed)"
    return Comparison(names, tuple(facts), (alone[0], alone[1]), tables, str(first["units"]["object"]))


def _words(value: Any) -> str:
    return f"{value:.8g}" if isinstance(value, float) else "-" if value is None else str(value)


def _finding(entry: Mapping[str, Any]) -> str:
    return f"{entry['severity']}: {entry['what']}"


def _changed_inputs(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Input files with different contents, with the first digits of their hashes."""
    a, b = first.get("inputs") or {}, second.get("inputs") or {}
    return [
        (f"file {name}", a.get(name, "-")[:12], b.get(name, "-")[:12])
        for name in sorted({*a, *b})
        if a.get(name) != b.get(name)
    ]


def _differences(table: str, first: Mapping[str, Any], second: Mapping[str, Any]) -> Differences:
    common = [name for name in first if name in second]
    if table in ("cameras", "parameters"):  # cameras have different elements: one row for each element
        a, b = _by_element(table, first, common), _by_element(table, second, common)
        rows = [row for row in a if row in b]
        left, right, columns = [a[r] for r in rows], [b[r] for r in rows], ("value",)
    else:
        rows = common
        columns = tuple(c for c, v in next(iter(first.values()), {}).items() if isinstance(v, list)) if rows else ()
        left, right = ([[data[r].get(c) for c in columns] for r in rows] for data in (first, second))
    shape = len(rows), max(len(columns), 1), 2
    one, other = (np.array(values, float).reshape(shape) for values in (left, right))
    difference = other[..., 0] - one[..., 0]
    sd = np.hypot(one[..., 1], other[..., 1])
    with np.errstate(all="ignore"):
        ratio = np.where(sd > 0, difference / sd, np.nan)
    only = len(first) - len(common), len(second) - len(common)
    return Differences(table, tuple(rows), columns, difference, sd, ratio, only)


def _by_element(table: str, data: Mapping[str, Any], names: list[str]) -> dict[str, list]:
    if table == "parameters":
        return {name: [data[name]["value"]] for name in names}
    return {f"{name} {element}": [value] for name in names for element, value in data[name].items()}


def congruency(comparison: Comparison, level: float = LEVEL) -> Congruency:
    """Tests two independent surveys at one level for all their points together.

    Raises: ValueError for a level not between 0 and 1, or where no point has a standard deviation in both.

    Example:
        >>> report = jb.report.report_dict(result)
        >>> float(jb.report.congruency(jb.report.compare_reports(report, report)).statistic)
        0.0
    """
    if not 0 < level < 1:
        raise ValueError(f"the level {level} is not between 0 and 1")
    points = [table for table in comparison.differences if table.table == "points"]
    squares = np.nan_to_num(points[0].ratio) ** 2 if points else np.zeros((0, 3))
    known = np.isfinite(points[0].ratio) if points else np.zeros((0, 3), bool)
    freedom = int(known.sum())
    if not freedom:
        raise ValueError("no point has a standard deviation in both results: adjust both with standard deviations")
    of_point = squares.sum(1)
    one = level_of_one(level, int(known.any(1).sum()))
    components = known.sum(1)
    limits = np.where(components > 0, chdtri(np.maximum(components, 1), one), np.inf)
    total = float(of_point.sum())
    limit, probability = float(chdtri(freedom, level)), float(chdtrc(freedom, total))
    return Congruency(total, freedom, limit, probability, level, of_point, limits, of_point > limits)
