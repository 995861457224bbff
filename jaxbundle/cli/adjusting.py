"""`jaxbundle adjust`: a path in, summary and findings to standard output, a folder of results."""

import math
from pathlib import Path
from typing import NamedTuple

import typer

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_interior_held
from jaxbundle.block.findings import Severity
from jaxbundle.block.problems import BlockError
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.cli.runtime import finished
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io import read
from jaxbundle.normals.reduced_plan import Method
from jaxbundle.numerics.devices import is_first_process
from jaxbundle.report.columns import wrapped
from jaxbundle.report.files import require_place, write_report
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.checkpoint import CheckpointError
from jaxbundle.solve.robust import WEIGHT_FUNCTIONS, AbstractWeightFunction
from jaxbundle.solve.stopping import AbstractStoppingRule, AngleRule, PointRule, parallax_rule, unknown_rule


class Wanted(NamedTuple):
    """How to solve, as the user says it."""

    method: str
    stop: str
    limit: float | None
    unknown: tuple[str, ...]
    max_iterations: int
    engine: str
    reduced: Method
    checkpoint: Path | None
    robust: AbstractWeightFunction | None
    hold_interior: bool
    precision: bool


def run(path: Path, out: Path | None, wanted: Wanted) -> int:
    """Adjusts, writes and prints; the exit code. Of several processes the first one writes and prints."""
    folder, first = out or Path(f"{path.resolve().stem}-adjusted"), is_first_process()
    adjustment = adjust_path(path, folder, wanted, ProgressLines(quiet=not first), first)
    if first:
        echo_result(adjustment)
        typer.echo(f"Results: {folder}")
    finished()
    return 0 if adjustment.trustworthy else 1


def adjust_path(path: Path, folder: Path, wanted: Wanted, lines: ProgressLines, writes: bool = True) -> Adjustment:
    """Reads, adjusts and, if this process `writes`, writes."""
    with lines.phase("reading ..."):
        block = read(path)
    block = with_interior_held(block) if wanted.hold_interior else block
    rule = stopping_rule(block, wanted)
    if writes:
        require_place(folder, block, wanted.robust is not None)  # before the work, not after it
    with lines.phase("adjusting"):
        adjustment = _adjusted(block, wanted, rule, lines)
    if writes:
        with lines.phase("writing"):
            write_report(adjustment, folder)
    return adjustment


def _adjusted(block: Block, wanted: Wanted, rule: AbstractStoppingRule, lines: ProgressLines) -> Adjustment:
    try:
        return adjust(
            block,
            method=wanted.method,
            stop=rule,
            max_iterations=wanted.max_iterations,
            precision=wanted.precision,
            engine=wanted.engine,
            reduced=wanted.reduced,
            checkpoint=wanted.checkpoint,
            robust=wanted.robust,
            progress=lines.iteration,
        )
    except CheckpointError as error:
        raise typer.BadParameter(str(error)) from error
    except ValueError as error:
        if isinstance(error, BlockError) or wanted.engine == "block":
            raise
        raise typer.BadParameter(str(error)) from error  # the second opinion takes small blocks only


def echo_result(adjustment: Adjustment) -> None:
    """Summary and findings; those that forbid trust are in the summary already."""
    typer.echo(adjustment.summary())
    for finding in findings(adjustment):
        if finding.severity is not Severity.FAILED:
            typer.echo("\n".join(wrapped(finding.severity.label, finding.words, 14)))


def weight_function(name: str | None, limit: float | None) -> AbstractWeightFunction | None:
    """The weight function of these options; None for least squares.

    Raises: typer.BadParameter for options that do not belong together.
    """
    if name is None:
        if limit is not None:
            raise typer.BadParameter("--robust-limit belongs to --robust")
        return None
    if limit is not None and not 0 < limit < math.inf:
        raise typer.BadParameter(f"--robust-limit {limit} is not positive")
    function = WEIGHT_FUNCTIONS[name]
    return function() if limit is None else function(limit=limit)


def stopping_rule(block: Block, wanted: Wanted) -> AbstractStoppingRule:
    """The rule of these options.

    Raises: typer.BadParameter for options that do not belong together, or an unknown that is not in the block.
    """
    limit = wanted.limit
    if limit is not None and not limit > 0:
        raise typer.BadParameter(f"--limit {limit} is not positive")
    if wanted.unknown and wanted.stop != "unknown":
        raise typer.BadParameter("--unknown belongs to --stop unknown")
    if wanted.stop == "angle":
        return AngleRule() if limit is None else AngleRule(limit=limit)
    if limit is None:
        raise typer.BadParameter(f"--stop {wanted.stop} needs a --limit")
    if wanted.stop == "points":
        return PointRule(limit=limit)
    if wanted.stop == "parallax":
        return parallax_rule(block, limit)
    try:
        return unknown_rule(block, limit, *map(_name_and_element, wanted.unknown))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def _name_and_element(text: str) -> tuple[str, str]:
    name, colon, element = text.rpartition(":")
    if not colon:
        raise typer.BadParameter(f"--unknown {text} is not NAME:ELEMENT, as 1_01:X0")
    return name, element
