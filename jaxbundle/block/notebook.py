"""A result for a notebook: a small table and the findings."""

import html
from collections.abc import Iterable, Sequence

from jaxbundle.block.findings import Finding

SHOWN = 12  # maximum number of findings; the others are counted
SHOWN_ROWS = 30  # rows of a table; the others are counted


def result_html(title: str, rows: Iterable[tuple[str, str]], findings: tuple[Finding, ...]) -> str:
    """HTML with a heading, a list of facts, and findings; without scripts and styles."""
    facts = "".join(
        f"<tr><th align='left'>{html.escape(label)}</th><td align='left'>{html.escape(words)}</td></tr>"
        for label, words in rows
    )
    items = "".join(
        f"<li><b>{html.escape(finding.severity.label)}</b>: {html.escape(finding.words)}</li>"
        for finding in findings[:SHOWN]
    )
    more = f"<p>and {len(findings) - SHOWN} more</p>" if len(findings) > SHOWN else ""
    found = f"<details open><summary>Findings: {len(findings)}</summary><ul>{items}</ul>{more}</details>"
    return f"<div><b>{html.escape(title)}</b><table>{facts}</table>{found if findings else ''}</div>"


def table_html(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], most: int = SHOWN_ROWS) -> str:
    """A heading and a table, of which the first rows are shown."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in heads)
    lines = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows[:most])
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    more = f"<p>and {len(rows) - most} more rows</p>" if len(rows) > most else ""
    return f"<div><b>{html.escape(title)}</b><table><tr>{head}</tr>{body}</table>{more}</div>"
