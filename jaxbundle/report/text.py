"""The report as plain text: problems and suggestions first, then the figures."""

import textwrap
from collections.abc import Sequence

from jaxbundle.block.given import require_a
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.made import made_section
from jaxbundle.report.section import Facts, ReportTable, Section
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjustment import Adjustment

WIDTH = 110


def report_text(adjustment: Adjustment) -> str:
    """The report of a concrete adjustment, ASCII, at most 110 columns.

    Example:
        >>> len(jb.report.report_text(result).splitlines()) > 20
        True
    """
    require_a(Adjustment, adjustment, "report.report_text")
    figures = figures_of(adjustment)
    return text_of(figures, [*(section() for section in sections_of(figures)), made_section(figures)])


def text_of(figures: Figures, sections: Sequence[Section]) -> str:
    """The report of sections as plain text."""
    structure = figures.structure
    title = f"Adjustment of block {structure.name or '(unnamed)'}"
    lines = [*textwrap.wrap(title, WIDTH), *textwrap.wrap(structure.source, WIDTH)]
    for section in sections:
        lines += section_lines(section)
    return "\n".join(line.rstrip() for line in lines).encode("ascii", "replace").decode() + "\n"


def section_lines(section: Section) -> list[str]:
    """The lines of a section below its heading; none where it has no parts."""
    body = [line for part in section.parts for line in _lines(part)]
    return ["", section.title, "-" * len(section.title), *body] if body else []


def _lines(part: Facts | ReportTable | str) -> list[str]:
    if isinstance(part, Facts):
        return [line for fact in part.facts if fact.text for line in wrapped(fact.label, fact.text, part.indent)]
    return _table(part) if isinstance(part, ReportTable) else [f"  {part}"]


def _table(table: ReportTable) -> list[str]:
    """The lines of a table; none where it has no rows."""
    columns = sorted((c for c in table.columns if c.head is not None), key=lambda column: column.place)
    beside = [c for c in columns if not (table.below and c.deviation_of)]
    rows = [[c.head or "" for c in beside]]
    for row in table.page.tolist():
        rows.append([c.show(c.values[row]) for c in beside])
        if table.below:
            deviations = {c.deviation_of: c.show(c.values[row]) for c in columns if c.deviation_of}
            rows.append([deviations.get(c.name, "") for c in beside])
    lines = aligned(rows, sum(c.is_name for c in beside)) if len(table.page) else []
    return [*lines, f"  {table.more}"] if table.more else lines


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Rows of cells as lines: the first `left` columns flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  "
        + "  ".join(c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in rows
    ]


def wrapped(label: str, text: str, indent: int) -> list[str]:
    """A label and its text, wrapped to several lines."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=f"  {label}".ljust(indent), subsequent_indent=" " * indent, break_on_hyphens=False
    )
