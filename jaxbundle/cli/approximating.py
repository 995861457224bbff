"""The command `jaxbundle approximate`: reads a block and writes it with approximate values."""

from pathlib import Path

import typer

from jaxbundle.block.changes import with_findings
from jaxbundle.block.unknowns import without_orientation
from jaxbundle.cli.codes import Code
from jaxbundle.io import read, write_block_folder
from jaxbundle.orientation.from_nothing import approximate


def run(path: Path, out: Path | None, anew: bool) -> int:
    """Computes approximate values, prints steps and findings, writes a block folder, and returns the exit code.

    Raises: BlockError or OSError for bad input; FileExistsError where the output exists.
    """
    folder = out or Path(f"{path.resolve().stem}-approximate")
    if folder.exists():
        raise FileExistsError(f"{folder} exists; give another name")
    found = approximate(read(path, check_start=False), anew=anew)
    typer.echo(found.summary())
    if without_orientation(found.block).all():
        typer.echo("No image could be oriented: no block is written")
        return Code.NOT_TRUSTED
    write_block_folder(with_findings(found.block, found.findings), folder)
    typer.echo(f"Block: {folder}")
    return Code.ADJUSTED if found.complete else Code.NOT_TRUSTED
