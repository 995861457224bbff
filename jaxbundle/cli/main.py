"""The command line: options in, one call, exit code out.

Exit codes: see `codes`. Whatever an error is, it ends in a sentence and its code, never in a traceback.

A command's own module is loaded when the command is called: help and wrong options shall not wait for JAX.
"""

import importlib
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import typer

from jaxbundle.cli import codes
from jaxbundle.cli.cluster import Cluster, cluster_of
from jaxbundle.cli.interruption import Interruption

_SOLVER, _CLUSTER = "Solver", "Cluster"  # headings in the help
_HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=_HELP,
    help="Photogrammetric bundle adjustment with derivatives through everything.",
)

Block = Annotated[Path, typer.Argument(metavar="PATH", help="A block folder or a BAL file.", show_default=False)]
Blocks = Annotated[list[Path], typer.Argument(metavar="PATH", help="Block folders or BAL files.", show_default=False)]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="Folder of the results (default: NAME-adjusted; of several blocks adjustments, with a folder for each).",
        show_default=False,
    ),
]


def main() -> None:
    """Runs a command; whatever goes wrong ends with a sentence and its exit code, never with a traceback."""
    try:
        app(prog_name="jaxbundle")
    except KeyboardInterrupt:
        sys.exit(codes.Code.INTERRUPTED)
    except Exception as error:
        code, words = codes.told(error)
        typer.echo(f"jaxbundle: {words}", err=True)
        sys.exit(code)


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
        bool | None,
        typer.Option("--version", "-V", callback=_version, is_eager=True, help="Show the version and exit."),
    ] = None,
) -> None:
    """Options of all commands."""


@app.command()
def adjust(
    paths: Blocks,
    out: Out = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that share several blocks and the cores.")] = 1,
    hold_interior: Annotated[bool, typer.Option("--hold-interior", help="Hold the interior of all cameras.")] = False,
    no_precision: Annotated[bool, typer.Option("--no-precision", help="No standard deviations.")] = False,
    robust: Annotated[
        Literal["huber", "cauchy", "tukey", "danish"] | None,
        typer.Option(help="Weight function that takes the weight of gross errors in the rays.", show_default=False),
    ] = None,
    robust_limit: Annotated[
        float | None,
        typer.Option(
            metavar="K",
            help="Limit of the weight function, in standard deviations (default: that of the function).",
            show_default=False,
        ),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="File that keeps the state after every accepted iteration; if it exists, go on from it."),
    ] = None,
    method: Annotated[
        Literal["levenberg-marquardt", "gauss-newton"],
        typer.Option(
            help="levenberg-marquardt: damped steps, for any start; gauss-newton: full steps, for a good start.",
            rich_help_panel=_SOLVER,
        ),
    ] = "levenberg-marquardt",
    stop: Annotated[
        Literal["angle", "points", "parallax", "unknown"],
        typer.Option(
            rich_help_panel=_SOLVER,
            help="Stopping rule: angle between the residuals and the tangent plane; largest change of a point"
            " coordinate; fall of the largest y-parallax; largest change of the unknowns named.",
        ),
    ] = "angle",
    limit: Annotated[
        float | None,
        typer.Option(
            help="Limit of the stopping rule: object unit for points, share of the principal distance for parallax,"
            " unit of the unknown (angles in radians); default: 1e-8 for angle.",
            show_default=False,
            rich_help_panel=_SOLVER,
        ),
    ] = None,
    unknown: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME:ELEMENT", help="Unknown of --stop unknown; may be repeated.", rich_help_panel=_SOLVER
        ),
    ] = None,
    max_iterations: Annotated[
        int, typer.Option(min=1, help="Maximum number of iterations.", rich_help_panel=_SOLVER)
    ] = 200,
    engine: Annotated[
        Literal["block", "jaxopt"],
        typer.Option(help="jaxopt: a second opinion on small blocks.", rich_help_panel=_SOLVER),
    ] = "block",
    reduced: Annotated[
        Literal["auto", "dense", "panels", "pcg"],
        typer.Option(help="How the reduced equations are solved; pcg needs --no-precision.", rich_help_panel=_SOLVER),
    ] = "auto",
    coordinator: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Address of process 0 of a cluster, the same for all, in a trusted network; auto: as Slurm, Open MPI"
            " or Kubernetes say.",
            show_default=False,
            rich_help_panel=_CLUSTER,
        ),
    ] = None,
    processes: Annotated[
        int | None, typer.Option(help="Processes of the cluster.", show_default=False, rich_help_panel=_CLUSTER)
    ] = None,
    process: Annotated[
        int | None,
        typer.Option(help="Number of this process, from 0 on.", show_default=False, rich_help_panel=_CLUSTER),
    ] = None,
) -> None:
    """Adjust blocks and write their reports and tables.

    Exit codes, of several blocks the largest:
    0 adjusted and trustworthy;
    1 adjusted, but not to be trusted (the first lines say why);
    2 bad input;
    3 the results could not be written to their folder (they are kept in a temporary one);
    4 an error of the program, or not enough memory;
    130 interrupted before a step was accepted.

    Ctrl-C, or SIGTERM, ends the iterations after the current step and keeps the last accepted unknowns; a second one
    ends at once, without results.
    """
    cluster = cluster_of(coordinator, processes, process)
    if len(paths) > 1 and (checkpoint is not None or cluster is not None):
        raise typer.BadParameter("a --checkpoint and a cluster belong to one block; adjust the blocks one by one")
    if reduced == "pcg" and not no_precision:
        raise typer.BadParameter("--reduced pcg gives no standard deviations and needs --no-precision")
    if robust is not None and checkpoint is not None:
        raise typer.BadParameter("--robust solves many times and keeps no --checkpoint")
    try:
        with Interruption() as interruption:
            adjusting = _loaded("adjusting", cluster)
            function = adjusting.weight_function(robust, robust_limit)
            options = adjusting.Options(
                method=method,
                max_iterations=max_iterations,
                precision=not no_precision,
                engine=engine,
                reduced=reduced,
                robust=function,
            )
            wanted = adjusting.Wanted(options, stop, limit, tuple(unknown or ()), checkpoint, hold_interior)
            if len(paths) == 1:
                code = adjusting.run(paths[0], out, wanted, interruption)
            else:
                several = importlib.import_module("jaxbundle.cli.several")
                code = several.run(paths, out, wanted, jobs, interruption)
    except KeyboardInterrupt:
        typer.echo("jaxbundle: interrupted before a step was accepted: no results are written", err=True)
        code = codes.Code.INTERRUPTED
    raise typer.Exit(code)


@app.command()
def check_partials(draws: Annotated[int, typer.Option(min=1, help="Random rays.")] = 100_000) -> None:
    """Check the textbook's 18 partials against automatic derivatives."""
    raise typer.Exit(_loaded("partials").run(draws))


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results.")] = Path("jaxbundle-demo"),
) -> None:
    """Simulate a strip and a block with known truth, adjust them and hold the results against the truth."""
    raise typer.Exit(_loaded("demo").run(out))


@app.command()
def pyramid(
    paths: Annotated[list[Path], typer.Argument(metavar="IMAGES", help="JPEG, PNG or TIFF.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the pyramids.")] = Path("pyramids"),
    zlib: Annotated[bool, typer.Option("--zlib", help="Compress the tiles: smaller files, slower windows.")] = False,
) -> None:
    """Make image pyramids: tiled TIFF with one sub-image for each level, found again by the next command."""
    measuring = importlib.import_module("jaxbundle.cli.pyramids")
    raise typer.Exit(measuring.run(paths, out, "zlib" if zlib else None))


@app.command()
def measure(
    images: Annotated[
        list[Path] | None, typer.Argument(metavar="IMAGES", help="Photographs, or folders of them.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The block folder.")] = Path("block"),
    refine: Annotated[
        Path | None,
        typer.Option(metavar="BLOCK", help="Measure the rays of this block again; needs --images.", show_default=False),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--images", metavar="DIR", help="Folder of the images of --refine.", show_default=False),
    ] = None,
    pyramids: Annotated[
        Path | None,
        typer.Option(help="Folder of the image pyramids (default: beside the images).", show_default=False),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Stations: image,latitude,longitude,altitude (default: EXIF).", show_default=False
        ),
    ] = None,
    principal_distance: Annotated[
        float | None, typer.Option(metavar="PX", help="Approximate principal distance.", show_default=False)
    ] = None,
    sensor_width: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Width of the sensor, with the focal length of EXIF.", show_default=False),
    ] = None,
    level: Annotated[int, typer.Option(min=0, help="Level of the pyramids on which points are found.")] = 1,
    points: Annotated[int, typer.Option(min=64, help="Largest number of points found in an image.")] = 2048,
) -> None:
    """Measure tie points in photographs and write a block folder, or measure the rays of a block again."""
    measuring = _loaded("measuring")
    if refine is not None:
        if folder is None or images:
            raise typer.BadParameter("--refine BLOCK needs --images DIR, and no other images")
        raise typer.Exit(measuring.run_refining(refine, folder, out, pyramids))
    if not images:
        raise typer.BadParameter("give photographs or folders of them")
    wanted = measuring.Wanted(images, out, pyramids, positions, principal_distance, sensor_width, level, points)
    raise typer.Exit(measuring.run(wanted))


@app.command()
def convert(
    path: Block,
    out: Annotated[Path, typer.Argument(help="A block folder, or a BAL file with suffix .txt.", show_default=False)],
) -> None:
    """Convert a block: BAL file or block folder to block folder or BAL file."""
    _loaded("converting").run(path, out)
