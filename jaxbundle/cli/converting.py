"""`jaxbundle convert`: between the forms a block is kept in."""

from pathlib import Path

import typer

from jaxbundle.cli.forms import form_of, write_form
from jaxbundle.io import Sources, read


def run(path: Path, out: Path, to: str, sources: Sources) -> None:
    """Reads a block, writes it in the form that `to` or the name of the output asks for, and says what is lost.

    Raises: FileExistsError where the output exists; typer.BadParameter for an unknown form.
    """
    form = form_of(out, to)
    block = read(path, sources=sources)
    for finding in block.structure.findings:
        typer.echo(f"{finding.severity.label}: {finding.words}")
    write_form(block, out, form)
    typer.echo(f"Block {block.structure.name}: {out}")
