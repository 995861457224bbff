"""The command `jaxbundle compare`: reads two folders of results, prints their differences and writes a page."""

import json
from pathlib import Path
from typing import Any

import typer

from jaxbundle.cli.codes import BadInput
from jaxbundle.numerics.whole_files import write_whole
from jaxbundle.report.comparison import compare_reports, congruency
from jaxbundle.report.comparison_report import comparison_html, comparison_text
from jaxbundle.report.result_folder import DATA


def run(first: Path, second: Path, out: Path | None, surveys: bool, level: float) -> None:
    """Reads, compares, prints, and writes the page.

    Raises: BadInput for folders without results, or without common names; OSError where the page cannot be
    written.
    """
    one, other = (result_data(folder) for folder in (first, second))
    try:
        found = compare_reports(one, other)
        test = congruency(found, level) if surveys else None
    except ValueError as error:
        raise BadInput(f"{first} and {second} cannot be compared: {error}") from error
    typer.echo(comparison_text(found, test), nl=False)
    if out is not None:
        page = comparison_html(found, test)
        write_whole(out, lambda file: file.write(page.encode("utf-8")))
        typer.echo(f"Page: {out}")


def result_data(folder: Path) -> dict[str, Any]:
    """Reads report.json of a folder of results.

    Raises: BadInput where there is none, or it is damaged.
    """
    path = folder / DATA
    if not path.is_file():
        raise BadInput(f"{folder} contains no {DATA}; give a folder that jaxbundle adjust has written")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is damaged: {error}; adjust the block again") from error
    if not isinstance(data, dict) or "units" not in data or "files" not in data:
        raise BadInput(f"{path} is not the report of a block; give a folder that jaxbundle adjust has written")
    return data
