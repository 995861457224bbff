"""`jaxbundle convert`: between the forms a block is kept in."""

from pathlib import Path

import typer

from jaxbundle.io import read, write_bal, write_block_folder

BAL_SUFFIX = ".txt"


def run(path: Path, out: Path) -> None:
    """Reads a block and writes it in the form that the name of the output asks for.

    Raises: FileExistsError where the output exists.
    """
    if out.exists():
        raise FileExistsError(f"{out} exists; give another name")
    block = read(path)
    if out.suffix == BAL_SUFFIX:
        write_bal(block, out)
    else:
        write_block_folder(block, out)
    typer.echo(f"Block {block.structure.name}: {out}")
