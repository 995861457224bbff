"""The command `jaxbundle convert`: converts a block between formats."""

from pathlib import Path

import typer

from jaxbundle.cli.forms import form_of, write_form
from jaxbundle.io import Sources, read


def run(path: Path, out: Path, to: str, sources: Sources) -> None:
    """Reads a block, writes it in the format of `to` or of the output name, and reports what is lost.

    Raises: FileExistsError where the output exists; typer.BadParameter for an unknown format.
    """
    form = form_of(out, to)
    block = read(path, sources=sources)
    for finding in block.structure.findings:
        typer.echo(f"{finding.severity.label}: {finding.words}")
    write_form(block, out, form)
    typer.echo(f"Block {block.structure.name}: {out}")
