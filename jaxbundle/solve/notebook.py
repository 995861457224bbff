"""A result for a notebook: a small table and the findings."""

import html
from collections.abc import Iterable

from jaxbundle.block.findings import Finding

SHOWN = 12  # maximum number of findings; the others are counted


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
