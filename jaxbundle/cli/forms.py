"""Formats in which the command line writes a block: block folder, BAL, formats of other programs, maps and clouds."""

from pathlib import Path

import typer

from jaxbundle.block.block import Block
from jaxbundle.io import export, write_bal, write_block_folder, write_format
from jaxbundle.io.formats.format_table import FORMATS, WRITTEN
from jaxbundle.io.results.export import EXPORTS

BAL, FOLDER, SHOWN = "bal", "block-folder", "export"
BAL_SUFFIX = ".txt"


def form_of(out: Path, to: str) -> str:
    """The format of `to`, or else of the name of the output.

    Raises: FileExistsError where the output exists; typer.BadParameter for an unknown format.
    """
    if out.exists():
        raise FileExistsError(f"{out} exists; give another name")
    if to and to not in (BAL, FOLDER, *WRITTEN):
        raise typer.BadParameter(f"--to {to} is unknown; known: {', '.join((BAL, FOLDER, *WRITTEN))}")
    if to:
        return to
    suffix = out.suffix.lower()
    if suffix == BAL_SUFFIX:
        return BAL
    if suffix in EXPORTS:
        return SHOWN
    return next((form.name for form in FORMATS.values() if form.write and form.suffix == suffix != ""), FOLDER)


def write_form(block: Block, out: Path, form: str) -> None:
    """Writes a block and prints what the format cannot represent."""
    if form == BAL:
        write_bal(block, out)
    elif form == FOLDER:
        write_block_folder(block, out)
    elif form == SHOWN:
        export(block, out)
    else:
        for words in write_format(block, out, form):
            typer.echo(f"not written ({form} cannot represent it): {words}")
