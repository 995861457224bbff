"""The complete HTML page: title, contents, chapters, style and script, with a content security policy."""

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.numerics.whole_files import write_whole
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.html.chapters import chapters_of
from jaxbundle.report.html.markup import tag, text
from jaxbundle.report.html.verdict_tiles import chapter_address
from jaxbundle.report.made import Made, made_now, made_section
from jaxbundle.report.section import Section
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjustment import Adjustment


def report_html(adjustment: Adjustment, made: Made | None = None, found: tuple[Finding, ...] | None = None) -> str:
    """The report of a concrete adjustment as one HTML page.

    Args:
        adjustment: the adjustment, of a block of photographs.
        made: program, date, command and inputs; if None, only the version of the program.
        found: the findings of `findings`; computed if None.

    Returns: the page, which needs no other file and no network; equal for equal adjustments.

    Raises: TypeError for other objects; ValueError for sensors that are not photographs.

    Example:
        >>> jb.report.report_html(result).startswith("<!")
        True
    """
    require_a(Adjustment, adjustment, "report.report_html")
    require_photographs(adjustment.block, "report.report_html")
    with np.errstate(all="ignore"):
        figures = figures_of(adjustment, found)
        sections = [*(section() for section in sections_of(figures)), made_section(figures, made)]
        return html_of(figures, sections)


def write_html(adjustment: Adjustment, path: str | Path, found: tuple[Finding, ...] | None = None) -> Path:
    """Writes the report of a concrete adjustment as one HTML page, with what was `found`, and returns its path.

    Raises: as `report_html`; OSError where the file cannot be written.

    Example:
        >>> jb.report.write_html(result, "report.html").name
        'report.html'
    """
    page, target = report_html(adjustment, made_now(), found), Path(path)
    write_whole(target, lambda file: file.write(page.encode("utf-8")))
    return target


def html_of(figures: Figures, sections: Sequence[Section]) -> str:
    """The HTML page of the numbers and sections of an adjustment."""
    structure, adjustment = figures.structure, figures.adjustment
    chapters = chapters_of(figures, sections)
    name = structure.name or "(unnamed)"
    links = [tag("a", text(chapter.value), href=f"#{chapter_address(chapter)}") for chapter in chapters]
    body = [
        tag("section", tag("h2", text(chapter.value)) + inside, id=chapter_address(chapter), class_="chapter")
        for chapter, inside in chapters.items()
    ]
    source = tag("p", text(structure.source), class_="more") if structure.source else ""
    title = tag("p", "Bundle adjustment", class_="kicker") + tag("h1", text(name))
    lead = tag("p", text(f"The adjustment {adjustment.verdict}."), class_="lead")
    return whole_page(f"{name} - adjustment", title + lead + source, links, body)


def whole_page(name: str, header: str, links: Sequence[str], body: Sequence[str]) -> str:
    """A page with our style and script; `header`, `links` and `body` are markup."""
    style, script = resource("page.css"), resource("page.js")
    # only the style and the script of this page are allowed, by their hashes (CSP level 2)
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )
    head = (
        '<meta charset="utf-8"/>'
        + tag("meta", http_equiv="Content-Security-Policy", content=policy)
        + tag("meta", name_="viewport", content="width=device-width, initial-scale=1")
        + tag("title", text(name))
        + f"<style>{style}</style>"
    )
    theme = tag("button", "Light / dark", type="button", id="theme", class_="scripted")
    contents = tag("nav", [*links, theme], aria_label="contents")
    main = tag("header", header) + contents + tag("main", body)
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{main}<script>{script}</script></body></html>\n'


def resource(name: str) -> str:
    """The text of a file of this folder."""
    return files("jaxbundle.report.html").joinpath(name).read_text(encoding="utf-8")


def _hash(content: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
