"""The command `jaxbundle adjust`: reads a path, prints summary and findings, and writes a folder of results."""

import dataclasses
import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import typer

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_interior_held
from jaxbundle.block.findings import Finding, Severity
from jaxbundle.block.problems import BlockError
from jaxbundle.cli.codes import BadInput, Code, LostProcess, told
from jaxbundle.cli.forms import form_of, write_form
from jaxbundle.cli.interruption import Interruption
from jaxbundle.cli.methods import Methods, adjusted_by, started
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.cli.runtime import finished
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io import Sources, export, read
from jaxbundle.io.results.export import EXPORTS
from jaxbundle.numerics.devices import is_first_process
from jaxbundle.report.files import require_place, rescue, write_report
from jaxbundle.report.made import Made, input_files, made_now
from jaxbundle.report.method_report import method_findings, require_place_of_method, write_method_report
from jaxbundle.report.method_sections import MethodAdjustment
from jaxbundle.report.text import wrapped
from jaxbundle.solve.adjust import Phase, Progress, adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.checkpoint import CheckpointError, ClusterError
from jaxbundle.solve.options import Options
from jaxbundle.solve.stopping_rules import AbstractStoppingRule, AngleRule, PointRule, parallax_rule, unknown_rule
from jaxbundle.solve.weight_functions import WEIGHT_FUNCTIONS, AbstractWeightFunction


class Wanted(NamedTuple):
    """Options of the adjustment. `stop`, `limit` and `unknown` define a stopping rule, which needs the block."""

    options: Options
    stop: str
    limit: float | None
    unknown: tuple[str, ...]
    checkpoint: Path | None
    hold_interior: bool
    methods: Methods = Methods()
    sources: Sources = Sources()
    exports: tuple[Path, ...] = ()
    write: Path | None = None
    to: str = ""


class Outcome(NamedTuple):
    """Outcome of the adjustment of a block.

    It has the adjustment, its findings, the folder of the results, and the problem of the target folder, if there is
    one.
    """

    adjustment: Adjustment
    found: tuple[Finding, ...]
    folder: Path | None
    code: Code
    problem: str = ""
    result: MethodAdjustment | None = None  # the adjustment of models or strips

    @property
    def block(self) -> Block:
        """The adjusted block of photographs, for any method."""
        return self.adjustment.block if self.result is None else self.result.block


def run(path: Path, out: Path | None, wanted: Wanted, stop: Interruption) -> int:
    """Adjusts, writes and prints, and returns the exit code. In a cluster the first process writes and prints."""
    _require_exports(wanted.exports)
    form = form_of(wanted.write, wanted.to) if wanted.write else ""
    folder, first = out or Path(f"{path.resolve().stem}-adjusted"), is_first_process()
    outcome = adjust_path(path, folder, wanted, ProgressLines(quiet=not first), stop)
    if first:
        if outcome.problem:
            typer.echo(f"jaxbundle: {outcome.problem}", err=True)
        echo_result(outcome.adjustment, outcome.found)
        typer.echo(f"Results: {outcome.folder or 'not written'}")
        for file in wanted.exports:
            export(outcome.adjustment, file)
            typer.echo(f"Export: {file}")
        if wanted.write:
            write_form(outcome.block, wanted.write, form)
            typer.echo(f"Adjusted block: {wanted.write}")
    finished()
    return outcome.code


def _require_exports(paths: tuple[Path, ...]) -> None:
    """Raises typer.BadParameter or FileExistsError for files that could not be written after the adjustment."""
    for path in paths:
        if path.suffix.lower() not in EXPORTS:
            raise typer.BadParameter(f"--export {path} has no known suffix; known: {', '.join(EXPORTS)}")
        if path.exists():
            raise FileExistsError(f"{path} exists; give another name")


def adjust_path(path: Path, folder: Path, wanted: Wanted, lines: ProgressLines, stop: Interruption) -> Outcome:
    """Reads, adjusts and, in the first process, writes.

    Raises: BlockError or OSError for bad input; KeyboardInterrupt before the first accepted step.
    """
    stop.begin()
    with lines.phase("reading"):
        block = read(path, sources=wanted.sources)
        made = made_now(shlex.join(["jaxbundle", *sys.argv[1:]]), input_files(path)) if is_first_process() else None
    block = with_interior_held(block) if wanted.hold_interior else block
    options, methods = dataclasses.replace(wanted.options, stop=stopping_rule(block, wanted)), wanted.methods
    if is_first_process():  # before the adjustment, not after it
        if methods.method == "bundle":
            require_place(folder, block, options.robust is not None)
        else:
            require_place_of_method(folder, block, methods.method)
    stop.check()

    def progress(iteration: Progress) -> None:
        lines.iteration(iteration)
        stop.step(iteration.accepted)

    lines.rule = options.stop
    with lines.phase("adjusting"):
        block, result = started(block, methods), None
        if methods.method == "bundle":
            adjustment = _adjusted(block, options, wanted.checkpoint, Watched(progress, lines.begins))
        else:
            result = adjusted_by(methods, block, options, progress)
            adjustment = result.adjustment
    stop.finish()
    code = Code.ADJUSTED if adjustment.trustworthy else Code.NOT_TRUSTED
    with lines.phase("judging"):  # in all processes, since it may adjust again
        outcome = _judged(Outcome(adjustment, adjustment.findings, folder, code, result=result), block)
    if not is_first_process():
        return outcome._replace(folder=None)
    with lines.phase("writing"):
        return _written(outcome, made)


def _judged(outcome: Outcome, block: Block) -> Outcome:
    """Adds all findings; any error here leaves the adjustment intact."""
    try:
        if outcome.result is not None:
            return outcome._replace(found=method_findings(outcome.result))
        return outcome._replace(found=findings(outcome.adjustment, block))
    except Exception as error:
        return outcome._replace(code=Code.UNEXPECTED, problem=told(error)[1])


def _written(outcome: Outcome, made: Made | None) -> Outcome:
    """Writes the results, to a temporary folder if their folder cannot be written."""
    assert outcome.folder is not None
    try:
        if outcome.result is None:
            write_report(outcome.adjustment, outcome.folder, outcome.found, made)
        else:
            write_method_report(outcome.result, outcome.folder, outcome.found)
        return outcome
    except OSError as error:
        code, problem = Code.NOT_WRITTEN, str(error)
    except Exception as error:  # an error of the report: the adjustment itself is complete
        code, problem = Code.UNEXPECTED, told(error)[1]
    try:
        kept = rescue(outcome.adjustment, outcome.found)
    except OSError as error:
        return outcome._replace(
            folder=None, code=code, problem=f"{problem}; a temporary folder cannot be written either: {error}"
        )
    return outcome._replace(folder=kept, code=code, problem=f"{problem}; the results were saved in {kept}")


class Watched(NamedTuple):
    """Functions that are called for iterations and phases."""

    progress: Callable[[Progress], None]
    phase: Callable[[Phase], None]


def _adjusted(block: Block, options: Options, checkpoint: Path | None, watched: Watched) -> Adjustment:
    try:
        return adjust(block, options=options, checkpoint=checkpoint, progress=watched.progress, phase=watched.phase)
    except CheckpointError as error:
        raise typer.BadParameter(str(error)) from error
    except ClusterError as error:
        raise BadInput(str(error)) from error
    except ValueError as error:
        if isinstance(error, BlockError) or options.engine == "block":
            raise
        raise typer.BadParameter(str(error)) from error  # the independent solver is for small blocks only
    except RuntimeError as error:
        if jax.process_count() == 1:
            raise
        raise LostProcess(error) from error


def echo_result(adjustment: Adjustment, found: tuple[Finding, ...]) -> None:
    """Prints summary and findings; the most severe findings are in the summary already."""
    typer.echo(adjustment.summary(found))
    for finding in found:
        if finding.severity is not Severity.FAILED:
            typer.echo("\n".join(wrapped(finding.severity.label, finding.words, 14)))


def weight_function(name: str | None, limit: float | None) -> AbstractWeightFunction | None:
    """The weight function of the options; None for least squares.

    Raises: typer.BadParameter for incompatible options.
    """
    if name is None:
        if limit is not None:
            raise typer.BadParameter("--robust-limit requires --robust")
        return None
    if limit is not None and not 0 < limit < math.inf:
        raise typer.BadParameter(f"--robust-limit {limit} is not positive")
    function = WEIGHT_FUNCTIONS[name]
    return function() if limit is None else function(limit=limit)


def stopping_rule(block: Block, wanted: Wanted) -> AbstractStoppingRule:
    """The stopping rule of the options.

    Raises: typer.BadParameter for incompatible options, or an unknown that is not in the block.
    """
    limit = wanted.limit
    if limit is not None and not limit > 0:
        raise typer.BadParameter(f"--limit {limit} is not positive")
    if wanted.unknown and wanted.stop != "unknown":
        raise typer.BadParameter("--unknown requires --stop unknown")
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
        raise typer.BadParameter(f"--unknown {text} is not NAME:ELEMENT, such as 1_01:X0")
    return name, element
