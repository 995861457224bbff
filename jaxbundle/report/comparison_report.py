"""A comparison of two results as sections, as text and as an HTML page."""

import numpy as np

from jaxbundle.report.comparison import Comparison, Congruency, Differences
from jaxbundle.report.html.html_tables import section_html
from jaxbundle.report.html.markup import tag, text
from jaxbundle.report.html.page import whole_page
from jaxbundle.report.section import (
    Chapter,
    Facts,
    ReportTable,
    Section,
    digits,
    fact,
    fixed,
    name_column,
    numbers,
    of_page,
    with_digits,
)
from jaxbundle.report.text import section_lines

SHOWN = 20  # rows of a table in the text
TITLES = {"points": "Object points", "images": "Images", "cameras": "Cameras", "parameters": "Parameters"}


def comparison_sections(found: Comparison, test: Congruency | None = None) -> list[Section]:
    """Sections of the differences between two results, the maximum first; with `test` also of a congruency test."""
    changed = [fact(label, f"{a}  ->  {b}") for label, a, b in found.facts if a != b]
    same = [fact(label, a) for label, a, b in found.facts if a == b and a != "-"]
    only = [
        (fact(f"only in {name}", words)) for name, group in zip("AB", found.findings, strict=True) for words in group
    ]
    sections = [Section("Congruency of two surveys", (_test(found, test),), Chapter.VERDICT)] if test else []
    sections += [
        Section("What differs", (Facts(tuple(changed), 20),) if changed else ("nothing",)),
        Section("What is the same", (Facts(tuple(same), 20),)),
        Section("Findings", (Facts(tuple(only), 20),) if only else ("the same in both",)),
    ]
    return sections + [_section(table, found, test) for table in found.differences]


def _test(found: Comparison, test: Congruency) -> Facts:
    moved = [name for name, is_moved in zip(found.differences[0].names, test.moved, strict=True) if is_moved]
    verdict = "the points are congruent" if test.congruent else "the points are not congruent"
    words = (
        f"{verdict}: sum of t^2 {test.statistic:.5g} of {test.freedom} coordinates, at most {test.limit:.5g} at a level"
        f" of {test.level:g} (chi-square), p = {test.probability:.2g}"
    )
    which = ", ".join(moved[:SHOWN]) + (f" and {len(moved) - SHOWN} more" if len(moved) > SHOWN else "")
    assumed = "the surveys are independent and have the same datum; correlations between points are neglected"
    return Facts(
        (
            fact("Test", words),
            fact("Displaced points", f"{len(moved)}: {which}" if moved else "none"),
            fact("Assumed", assumed),
        ),
        16,
    )


def _section(found: Differences, whole: Comparison, test: Congruency | None) -> Section:
    size = np.nan_to_num(np.abs(found.ratio)).max(1, initial=0.0)
    order = np.argsort(-size, kind="stable")
    heads = [f"d{c}" if c != "value" else "difference" for c in found.columns]
    sds = [f"sd {h}" for h in heads] if len(heads) <= 3 else ()  # six elements of an image fill the width of a page
    columns = [
        name_column(found.table.removesuffix("s"), found.names),
        *numbers(heads, found.difference, heads, show=lambda v: digits(v, 4), place=1),
        *numbers([f"s{h}" for h in heads], found.sd, sds, show=lambda v: digits(v, 3), place=2),
        *numbers([f"t{h}" for h in heads], found.ratio, [f"t {h}" for h in heads], show=lambda v: fixed(v, 2), place=3),
    ]
    if test is not None and found.table == "points":
        columns.append(of_page("sum t^2", test.points, with_digits(4)))
        columns.append(of_page("", np.where(test.moved, "moved", "")))
    t = found.ratio[np.isfinite(found.ratio)]
    rms = float(np.sqrt(np.mean(t**2))) if len(t) else float("nan")
    said = f"{len(found.names)} in both, {found.only[0]} only in A, {found.only[1]} only in B"
    said += f"; rms of t {digits(rms, 3)}, maximum {digits(float(size.max(initial=0.0)), 3)}"
    more = f"... the first {SHOWN} of {len(order)} rows; the page has more (--out)" if len(order) > SHOWN else ""
    table = ReportTable(found.table, tuple(columns), order[:SHOWN], more, in_file=False, rows=order)
    unit = f" [{whole.unit}]" if found.table == "points" else ""
    return Section(f"{TITLES[found.table]}: B minus A, maximum t first{unit}", (said, table))


def comparison_text(found: Comparison, test: Congruency | None = None) -> str:
    """The comparison as plain text, ASCII."""
    lines = [f"A: {found.names[0]}", f"B: {found.names[1]}"]
    for section in comparison_sections(found, test):
        lines += section_lines(section)
    return "\n".join(line.rstrip() for line in lines).encode("ascii", "replace").decode() + "\n"


def comparison_html(found: Comparison, test: Congruency | None = None) -> str:
    """The comparison as one HTML page, similar to `report_html`."""
    body = [
        tag("section", section_html(section, {}, {}), class_="chapter") for section in comparison_sections(found, test)
    ]
    header = tag("p", "Comparison of two adjustments", class_="kicker") + tag("h1", text(" and ".join(found.names)))
    header += tag("p", "Differences are second minus first; t is the difference over its standard deviation.")
    return whole_page("Comparison of two adjustments", header, [], body)
