"""The command `jaxbundle show`: opens the report of a folder of results."""

import os
import sys
import webbrowser
from pathlib import Path

import typer

from jaxbundle.cli.codes import BadInput
from jaxbundle.report.result_folder import PAGE, TEXT


def run(folder: Path, in_text: bool) -> None:
    """Opens the page in the browser and prints its path; without a screen, or on request, prints the text.

    Raises: BadInput where the folder contains no report.
    """
    page, words = folder / PAGE, folder / TEXT
    if not words.is_file():
        raise BadInput(f"{folder} contains no {TEXT}; give a folder that jaxbundle adjust has written")
    if in_text or not page.is_file():
        typer.echo(words.read_text(encoding="utf-8"), nl=False)
        return
    opened = has_screen() and webbrowser.open(page.resolve().as_uri())
    typer.echo(f"Report: {page}" if opened else f"Report: {page} (open it in a browser, or call show with --text)")


def has_screen() -> bool:
    """Whether this machine has a screen for a browser."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
