"""Plain text: columns that are aligned, numbers of which every digit tells something."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np

WIDTH = 110
LARGEST_FIXED = 1e12  # with four decimals already beyond double precision
NAME = 18  # longer names are shortened in the text; tables have them in full


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Rows of cells as lines: the first `left` columns flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  "
        + "  ".join(c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]


def wrapped(label: str, text: str, indent: int) -> list[str]:
    """A label and a text beside it, as many lines as it takes."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=f"  {label}".ljust(indent), subsequent_indent=" " * indent, break_on_hyphens=False
    )


def short(name: str, longest: int = NAME) -> str:
    """A name of at most so many characters."""
    return name if len(name) <= longest else f"{name[: longest - 10]}...{name[-7:]}"


def decimals(deviations: np.ndarray) -> int:
    """Decimals with which the typical standard deviation has two digits; 4 where there is none."""
    known = deviations[np.isfinite(deviations) & (deviations > 0)]
    return int(np.clip(1 - math.floor(math.log10(np.median(known))), 0, 9)) if len(known) else 4


def fixed(value: float, places: int) -> str:
    """A number with so many decimals; "-" where there is none, and with an exponent where it is absurdly large."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}" if abs(value) < LARGEST_FIXED else f"{value:.6g}"


def with_unit(name: str, unit: str) -> str:
    """The head of a column."""
    return f"{name} [{unit}]" if unit else name


def deviation(value: float, places: int) -> str:
    """A standard deviation; "held" for 0."""
    return "held" if value == 0 else fixed(value, places)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], count: int, what: str, left: int = 1) -> list[str]:
    """A table of the first rows of `count`, and where the others are."""
    lines = aligned([header, *rows], left)
    shown = len(rows)
    return lines if shown == count else [*lines, f"  ... the first {shown} of {count} {what}; the tables hold all"]
