"""`jaxbundle check-partials`."""

import typer

from jaxbundle.textbook.cross_checks import crosscheck


def run(draws: int) -> int:
    """Prints the table and the verdict; 0 if the partials hold."""
    check = crosscheck(draws=draws)
    typer.echo(f"{check.table()}\n\n{check.verdict()}")
    return 0 if check.passed else 1
