"""The command line: options in, one call, exit code out.

Exit codes: 0 adjusted, 1 adjusted but not to be trusted, 2 bad input.

A command's own module is loaded when the command is called: help and wrong options shall not wait for JAX.
"""

import importlib
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import typer

from jaxbundle.block.problems import BlockError
from jaxbundle.cli.cluster import Cluster, cluster_of

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Photogrammetric bundle adjustment with derivatives through everything.",
)

Block = Annotated[Path, typer.Argument(metavar="PATH", help="A block folder or a BAL file.", show_default=False)]
Blocks = Annotated[
    list[Path], typer.Argument(metavar="PATH...", help="Block folders or BAL files.", show_default=False)
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the results.  [default: <name>-adjusted; adjustments, with a folder for each, for several]",
        show_default=False,
    ),
]


def main() -> None:
    """Runs a command; bad input ends with a message and exit code 2, never with a traceback."""
    try:
        app(prog_name="jaxbundle")
    except (BlockError, OSError) as error:
        typer.echo(f"jaxbundle: {error}", err=True)
        sys.exit(2)


def _loaded(command: str, cluster: Cluster | None = None) -> ModuleType:
    """The module of a command, with JAX set up for it."""
    importlib.import_module("jaxbundle.cli.runtime").start(cluster)
    return importlib.import_module(f"jaxbundle.cli.{command}")


def _version(wanted: bool | None) -> None:
    if wanted:
        typer.echo(f"jaxbundle {version('jaxbundle')}")
        raise typer.Exit


@app.callback()
def options(
    version_wanted: Annotated[
        bool | None, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = None,
) -> None:
    """Options of all commands."""


@app.command()
def adjust(
    paths: Blocks,
    out: Out = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that share several blocks and the cores.")] = 1,
    method: Annotated[Literal["levenberg-marquardt", "gauss-newton"], typer.Option()] = "levenberg-marquardt",
    stop: Annotated[
        Literal["angle", "points", "parallax", "unknown"],
        typer.Option(
            help="Stopping rule: angle between the residuals and the tangent plane; largest change of a point"
            " coordinate; fall of the largest y-parallax; largest change of the unknowns named."
        ),
    ] = "angle",
    limit: Annotated[
        float | None,
        typer.Option(
            help="Limit of the stopping rule: object unit for points, share of the principal distance for parallax,"
            " unit of the unknown (angles in radians).  [default: 1e-8 for angle]",
            show_default=False,
        ),
    ] = None,
    unknown: Annotated[
        list[str] | None, typer.Option(metavar="NAME:ELEMENT", help="Unknown of --stop unknown; may be repeated.")
    ] = None,
    max_iterations: Annotated[int, typer.Option(min=1)] = 200,
    engine: Annotated[
        Literal["block", "jaxopt"], typer.Option(help="jaxopt: a second opinion on small blocks.")
    ] = "block",
    hold_interior: Annotated[bool, typer.Option("--hold-interior", help="Hold the interior of all cameras.")] = False,
    reduced: Annotated[
        Literal["auto", "dense", "panels", "pcg"],
        typer.Option(help="How the reduced equations are solved; pcg needs --no-precision."),
    ] = "auto",
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="File that keeps the state after every accepted iteration; if it exists, go on from it."),
    ] = None,
    robust: Annotated[
        Literal["huber", "cauchy", "tukey", "danish"] | None,
        typer.Option(help="Weight function that takes the weight of gross errors in the rays.", show_default=False),
    ] = None,
    robust_limit: Annotated[
        float | None,
        typer.Option(
            metavar="K",
            help="Limit of the weight function, in standard deviations.  [default: that of the function]",
            show_default=False,
        ),
    ] = None,
    no_precision: Annotated[bool, typer.Option("--no-precision", help="No standard deviations.")] = False,
    coordinator: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Address of process 0 of a cluster, the same for all; auto: as Slurm, Open MPI or Kubernetes say.",
            show_default=False,
        ),
    ] = None,
    processes: Annotated[int | None, typer.Option(help="Processes of the cluster.", show_default=False)] = None,
    process: Annotated[int | None, typer.Option(help="Number of this process, from 0 on.", show_default=False)] = None,
) -> None:
    """Adjust blocks and write their reports and tables.

    Exit code 0: adjusted; 1: adjusted, but not converged or with undetermined unknowns; 2: bad input; of several blocks
    the worst. Ctrl-C ends the iterations and keeps the last accepted unknowns; of several blocks, those of one process.
    """
    cluster = cluster_of(coordinator, processes, process)
    if len(paths) > 1 and (checkpoint is not None or cluster is not None):
        raise typer.BadParameter("a --checkpoint and a cluster belong to one block; adjust the blocks one by one")
    adjusting = _loaded("adjusting", cluster)
    if reduced == "pcg" and not no_precision:
        raise typer.BadParameter("--reduced pcg gives no standard deviations and needs --no-precision")
    if robust is not None and checkpoint is not None:
        raise typer.BadParameter("--robust solves many times and keeps no --checkpoint")
    function = adjusting.weight_function(robust, robust_limit)
    wanted = adjusting.Wanted(
        method,
        stop,
        limit,
        tuple(unknown or ()),
        max_iterations,
        engine,
        reduced,
        checkpoint,
        function,
        hold_interior,
        not no_precision,
    )
    if len(paths) == 1:
        raise typer.Exit(adjusting.run(paths[0], out, wanted))
    raise typer.Exit(importlib.import_module("jaxbundle.cli.several").run(paths, out, wanted, jobs))


@app.command()
def check_partials(draws: Annotated[int, typer.Option(min=1, help="Random rays.")] = 100_000) -> None:
    """Check the textbook's 18 partials against automatic derivatives."""
    raise typer.Exit(_loaded("partials").run(draws))


@app.command()
def demo(out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("jaxbundle-demo")) -> None:
    """Simulate a strip and a block with known truth, adjust them and hold the results against the truth."""
    raise typer.Exit(_loaded("demo").run(out))


@app.command()
def convert(
    path: Block,
    out: Annotated[Path, typer.Argument(help="A block folder, or a BAL file with suffix .txt.", show_default=False)],
) -> None:
    """Convert a block: BAL file or block folder to block folder or BAL file."""
    _loaded("converting").run(path, out)
