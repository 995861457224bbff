"""The command `jaxbundle check-partials`, a check of partial derivatives."""

import typer

from jaxbundle.textbook.cross_checks import crosscheck


def run(draws: int) -> int:
    """Prints the table and the verdict; returns 0 if the partial derivatives agree."""
    check = crosscheck(draws=draws)
    typer.echo(f"{check.table()}\n\n{check.verdict()}")
    return 0 if check.passed else 1
