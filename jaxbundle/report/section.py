"""Types of a report: sections of facts and tables, in the user's names and units, for the renderers.

A section is made once. The text shows the first rows of each table, CSV files contain all rows, and report.json the
facts and the rows that are results. Each output format is a renderer.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Int

MAX_FIXED = 1e12  # four decimals exceed double precision
NAME, PARAMETER, OWNER = 18, 36, 26  # longer names, of parameters, and of those with two ends, are shortened


class Chapter(Enum):
    """The chapter of a section; the values are the titles of the chapters, in their order."""

    VERDICT = "Verdict"
    PLAN = "Block"
    CONTROL = "Control and check points"
    RESIDUALS = "Residuals of the rays"
    IMAGES = "Images"
    CAMERAS = "Cameras"
    POINTS = "Object points"
    CONNECTIONS = "Connections"
    RELIABILITY = "Reliability"
    OTHERS = "Groups of observations"
    ITERATIONS = "Iterations"
    MADE = "How it was made"


@dataclass(frozen=True, eq=False)
class Picked:
    """Names by index: a list of names would need much memory for millions of rays."""

    names: tuple[str, ...]
    index: Int[np.ndarray, " row"]

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, row: int) -> str:
        return self.names[self.index[row]]


@dataclass(frozen=True, eq=False)
class ReportColumn:
    """A column of a table: its name and its values, NaN where unknown.

    `head`: the heading in the text, where `show` formats the values; None if the text does not show the column.
    `place`: columns with a smaller number come first. `deviation_of`: the column to which these standard deviations
    belong. `is_name`: the values are the names of the rows. `in_file`, `is_result`: whether the CSV file or report.json
    has the column.
    """

    name: str
    values: Sequence[str] | Picked | np.ndarray
    head: str | None = None
    show: Callable[[Any], str] = str
    place: int = 2
    deviation_of: str = ""
    is_name: bool = False
    in_file: bool = True
    is_result: bool = False


@dataclass(frozen=True, eq=False)
class ReportTable:
    """Rows of one type. `name`: name of its file and its key in report.json.

    `page`: the rows that the text shows; `more`: where the others are. `results`: the rows in report.json, None if
    the table is not in it. `below`: standard deviations are in a line below the values. `rows`: all rows in the order
    of the text, for formats that show more of them; `page` if None.
    """

    name: str
    columns: tuple[ReportColumn, ...]
    page: Int[np.ndarray, " shown"]
    more: str = ""
    results: Int[np.ndarray, " result"] | None = None
    below: bool = False
    in_file: bool = True
    rows: Int[np.ndarray, " row"] | None = None


@dataclass(frozen=True)
class Fact:
    """A label, its text, if it has one, and the same as entries of report.json."""

    label: str
    text: str
    entries: dict[str, Any]


@dataclass(frozen=True)
class Facts:
    """Facts in a column; `indent` is the column of their text."""

    facts: tuple[Fact, ...]
    indent: int


@dataclass(frozen=True)
class Section:
    """A heading with facts, tables and sentences. A section without any of them is left out."""

    title: str
    parts: tuple[Facts | ReportTable | str, ...]
    chapter: Chapter = Chapter.OTHERS


def fact(label: str, text: str, **entries: Any) -> Fact:
    """A fact with its entries as keywords."""
    return Fact(label, text, entries)


def name_column(name: str, values: Sequence[str] | Picked, longest: int = 0) -> ReportColumn:
    """A column with the names of the rows; the text shortens them."""
    return ReportColumn(name, values, name, lambda v: short(v, longest) if longest else short(v), 0, is_name=True)


def measured(
    names: Sequence[str], values: np.ndarray, deviations: np.ndarray, units: Sequence[str], places: Sequence[int]
) -> tuple[ReportColumn, ...]:
    """Columns of values, then of their standard deviations, with a number of decimals in the text."""
    heads = zip(names, values.T, deviations.T, units, places, strict=True)
    columns = [
        (
            ReportColumn(name, value, with_unit(name, unit), lambda v, p=p: fixed(v, p), is_result=True),
            ReportColumn(
                f"s{name}", sd, with_unit(f"sd {name}", unit), lambda v, p=p: deviation(v, p), 4, deviation_of=name
            ),
        )
        for name, value, sd, unit, p in heads
    ]
    return (*(value for value, _ in columns), *(sd for _, sd in columns))


def numbers(
    names: Sequence[str], values: np.ndarray, heads: Sequence[str] = (), **more: Any
) -> tuple[ReportColumn, ...]:
    """Columns of numbers that belong together; columns without heads are not in the text."""
    named = zip(names, values.T, heads or [None] * len(names), strict=True)
    return tuple(ReportColumn(name, column, head, **more) for name, column, head in named)


def of_page(head: str, values: Sequence[str] | Picked | np.ndarray, show: Callable[[Any], str] = str, place: int = 5):
    """A column that only the text shows."""
    return ReportColumn("", values, head, show, place, in_file=False)


def with_digits(count: int) -> Callable[[float], str]:
    """A function that formats numbers with the given number of digits."""
    return lambda value: digits(value, count)


def first(rows: np.ndarray, limit: int, what: str) -> tuple[np.ndarray, str]:
    """The first rows, and a note about the others if there are more."""
    count = len(rows)
    return rows[:limit], f"... the first {limit} of {count} {what}; the tables contain all" if count > limit else ""


def short(name: str, longest: int = NAME) -> str:
    """A name shortened to a maximum number of characters."""
    return name if len(name) <= longest else f"{name[: longest - 10]}...{name[-7:]}"


def decimals(deviations: np.ndarray) -> int:
    """Number of decimals for two digits of the typical standard deviation; 4 where there is none."""
    known = deviations[np.isfinite(deviations) & (deviations > 0)]
    return int(np.clip(1 - math.floor(math.log10(np.median(known))), 0, 9)) if len(known) else 4


def fixed(value: float, places: int) -> str:
    """A number with a number of decimals; "-" for NaN, with an exponent if it is absurdly large."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}" if abs(value) < MAX_FIXED else f"{value:.6g}"


def deviation(value: float, places: int) -> str:
    """A standard deviation as text; "fixed" for 0."""
    return "fixed" if value == 0 else fixed(value, places)


def digits(value: float, count: int) -> str:
    """A number with a number of digits; "-" for NaN."""
    return f"{value:.{count}g}" if math.isfinite(value) else "-"


def with_unit(name: str, unit: str) -> str:
    """The head of a column."""
    return f"{name} [{unit}]" if unit else name
