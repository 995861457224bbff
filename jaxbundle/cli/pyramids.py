"""The command `jaxbundle pyramid`: makes pyramids of photographs, and reuses existing ones."""

from pathlib import Path

import typer

from jaxbundle.block.problems import Problem
from jaxbundle.cli.codes import Code
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.imagery.image_problems import ImageError
from jaxbundle.imagery.pyramid_file import pyramid


def run(paths: list[Path], out: Path, compression: str | None) -> int:
    """Makes the pyramids and prints their files; problems of single images are listed together at the end.

    Raises: ImageError.
    """
    lines, problems = ProgressLines(), list[Problem]()
    for path in paths:
        try:
            with lines.phase(f"pyramid of {path.name}"):
                made = pyramid(path, out, compression=compression)
        except FileNotFoundError:
            problems.append(Problem("does not exist", "check the name", str(path)))
        except ImageError as error:
            problems.extend(error.problems)
        else:
            rows, columns = made.sizes[0]
            typer.echo(f"{made.path}: {columns} x {rows} px, {len(made.sizes)} levels")
    if problems:
        raise ImageError(problems)
    return Code.ADJUSTED
