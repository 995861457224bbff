"""`jaxbundle convert`: between the forms a block is kept in."""

from pathlib import Path

import typer

from jaxbundle.io import Sources, export, read, write_bal, write_block_folder, write_format
from jaxbundle.io.formats.registry import FORMATS, WRITTEN
from jaxbundle.io.results.export import EXPORTS

BAL, FOLDER = "bal", "block-folder"
BAL_SUFFIX = ".txt"


def run(path: Path, out: Path, to: str, sources: Sources) -> None:
    """Reads a block, writes it in the form that `to` or the name of the output asks for, and says what is lost.

    Raises: FileExistsError where the output exists; typer.BadParameter for an unknown form.
    """
    if out.exists():
        raise FileExistsError(f"{out} exists; give another name")
    form = to or _form_of(out)
    shown = not to and out.suffix.lower() in EXPORTS
    if form not in (BAL, FOLDER, *WRITTEN):
        raise typer.BadParameter(f"--to {form} is unknown; known: {', '.join((BAL, FOLDER, *WRITTEN))}")
    block = read(path, sources=sources)
    for finding in block.structure.findings:
        typer.echo(f"{finding.severity.label}: {finding.words}")
    if shown:
        export(block, out)
    elif form == BAL:
        write_bal(block, out)
    elif form == FOLDER:
        write_block_folder(block, out)
    else:
        for words in write_format(block, out, form):
            typer.echo(f"not held by {form}: {words}")
    typer.echo(f"Block {block.structure.name}: {out}")


def _form_of(out: Path) -> str:
    """The form that a name asks for."""
    if out.suffix == BAL_SUFFIX:
        return BAL
    found = (form.name for form in FORMATS.values() if form.write and form.suffix and out.suffix.lower() == form.suffix)
    return next(found, FOLDER)
