"""The command line: each command parses its options, calls one function and returns an exit code.

Exit codes: see `codes`. Any error ends with a message and an exit code, never with a traceback.

The module of a command is imported when the command is called: help and wrong options do not wait for JAX.
"""

import gc
import importlib
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import typer

from jaxbundle.cli import codes, photograph_commands, planning
from jaxbundle.cli.cluster import Cluster, cluster_of
from jaxbundle.cli.interruption import Interruption
from jaxbundle.cli.shared_options import (
    CLUSTER,
    SOLVER,
    AttitudeSigma,
    Block,
    Blocks,
    Chunk,
    Control,
    Coordinator,
    Exports,
    Form,
    Interior,
    Limit,
    Out,
    PixelSize,
    RobustLimit,
    Sigmas,
    Size,
    Stations,
    Stop,
    Unknown,
)
from jaxbundle.cli.source_options import Told

_METHOD = "Method"  # a heading in the help of adjust
_WORK, _LEARN, _CHECK = "Adjust", "Learn and start", "Check the program"  # headings in the list of commands
_HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=_HELP,
    help="Photogrammetric bundle adjustment with the precision and the reliability of all results.\n\n"
    "Start: jaxbundle new quarry, then jaxbundle adjust quarry. Pages: jaxbundle docs.",
)

app.add_typer(planning.app, name="plan")
app.command(rich_help_panel=_WORK)(photograph_commands.measure)
app.command(rich_help_panel=_WORK)(photograph_commands.pyramid)


def main() -> None:
    """Runs a command; any error ends with a message and an exit code, never with a traceback."""
    gc.set_threshold(100_000, 20, 100)  # imports and tracing make many objects and few cycles: 1 s of each command
    try:
        app(prog_name="jaxbundle")
    except KeyboardInterrupt:
        sys.exit(codes.Code.INTERRUPTED)
    except Exception as error:
        code, words = codes.told(error)
        typer.echo(f"jaxbundle: {words}", err=True)
        sys.exit(code)


def _loaded(command: str, cluster: Cluster | None = None) -> ModuleType:
    """Imports the module of a command after the set-up of JAX."""
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
    """Handles the options of all commands."""


@app.command(rich_help_panel=_WORK)
def adjust(
    paths: Blocks,
    out: Out = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of processes that adjust several blocks in parallel.")] = 1,
    show: Exports = None,
    write: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT", help="Write the adjusted block to this path, in any format of `convert`.", show_default=False
        ),
    ] = None,
    to: Annotated[
        str, typer.Option(help="The format of --write, if its name does not determine it.", metavar="NAME")
    ] = "",
    hold_interior: Annotated[
        bool, typer.Option("--hold-interior", help="Keep the interior orientation of all cameras fixed.")
    ] = False,
    no_precision: Annotated[
        bool, typer.Option("--no-precision", help="Compute no standard deviations, which saves time.")
    ] = False,
    robust: Annotated[
        Literal["huber", "cauchy", "tukey", "danish"] | None,
        typer.Option(
            help="Robust adjustment: the weight function that down-weights gross errors of image coordinates.",
            show_default=False,
        ),
    ] = None,
    robust_limit: RobustLimit = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            help="File for the state after each accepted iteration; if it exists, the adjustment resumes from it."
        ),
    ] = None,
    method: Annotated[
        Literal["bundle", "models", "strips", "levenberg-marquardt", "gauss-newton"],
        typer.Option(
            help="bundle: all rays at once; models: independent models of two images; strips: independent strips,"
            " corrected by polynomials. levenberg-marquardt (damped steps, for any start) and gauss-newton (full steps,"
            " for a good start) select the solver of the bundle.",
            rich_help_panel=_METHOD,
        ),
    ] = "bundle",
    start: Annotated[
        Literal["models", "strips"] | None,
        typer.Option(
            help="First adjust with this method, and start from its results.",
            show_default=False,
            rich_help_panel=_METHOD,
        ),
    ] = None,
    degree: Annotated[
        int, typer.Option(min=2, max=3, help="Degree of the polynomials of strips.", rich_help_panel=_METHOD)
    ] = 2,
    polynomials: Annotated[
        Literal["separate", "plan-conformal", "conformal"],
        typer.Option(help="Polynomials of strips: how X, Y and Z are coupled.", rich_help_panel=_METHOD),
    ] = "separate",
    stop: Stop = "angle",
    limit: Limit = None,
    unknown: Unknown = None,
    max_iterations: Annotated[
        int, typer.Option(min=1, help="Maximum number of iterations.", rich_help_panel=SOLVER)
    ] = 200,
    engine: Annotated[
        Literal["block", "jaxopt"],
        typer.Option(help="jaxopt: an independent solver for small blocks, for comparison.", rich_help_panel=SOLVER),
    ] = "block",
    reduced: Annotated[
        Literal["auto", "dense", "panels", "pcg"],
        typer.Option(
            help="How the reduced normal equations are solved; pcg needs --no-precision.", rich_help_panel=SOLVER
        ),
    ] = "auto",
    coordinator: Coordinator = None,
    processes: Annotated[
        int | None,
        typer.Option(help="Number of processes of the cluster.", show_default=False, rich_help_panel=CLUSTER),
    ] = None,
    process: Annotated[
        int | None,
        typer.Option(help="Number of this process, starting at 0.", show_default=False, rich_help_panel=CLUSTER),
    ] = None,
    form: Form = "",
    control: Control = None,
    stations: Stations = None,
    control_sigma: Sigmas = "",
    station_sigma: Sigmas = "",
    attitude_sigma: AttitudeSigma = None,
    image_size: Size = "",
    chunk: Chunk = "",
    interior: Interior = "",
    pixel_size: PixelSize = None,
) -> None:
    """Adjust one or several blocks and write their reports and tables.

    Exit codes (for several blocks, the maximum):
    0 adjusted and trustworthy;
    1 adjusted, but not to be trusted (the first lines give the reason);
    2 bad input;
    3 the results could not be written to their folder (they are saved in a temporary one);
    4 an internal error, or not enough memory;
    130 interrupted before a step was accepted.

    Ctrl-C, or SIGTERM, ends the iterations after the current step and keeps the last accepted unknowns; a second one
    stops immediately, without results.
    """
    cluster = cluster_of(coordinator, processes, process)
    if len(paths) > 1 and (checkpoint is not None or cluster is not None):
        raise typer.BadParameter("--checkpoint and a cluster support one block only; adjust the blocks one by one")
    if (show or write) and len(paths) > 1:
        raise typer.BadParameter("--export and --write support one block only; adjust the blocks one by one")
    if reduced == "pcg" and not no_precision:
        raise typer.BadParameter("--reduced pcg gives no standard deviations and needs --no-precision")
    if robust is not None and checkpoint is not None:
        raise typer.BadParameter("--checkpoint is not supported together with --robust")
    by_rays = method in ("bundle", "levenberg-marquardt", "gauss-newton")
    if not by_rays and (checkpoint is not None or cluster is not None or stop in ("parallax", "unknown")):
        raise typer.BadParameter(
            f"--checkpoint, a cluster and --stop parallax or unknown require the bundle, not --method {method}"
        )
    if polynomials == "conformal" and degree != 2:
        raise typer.BadParameter("--polynomials conformal require degree 2; others degree 2 or 3")
    try:
        with Interruption() as interruption:
            adjusting = _loaded("adjusting", cluster)
            function = adjusting.weight_function(robust, robust_limit)
            options = adjusting.Options(
                method="gauss-newton" if method == "gauss-newton" else "levenberg-marquardt",
                max_iterations=max_iterations,
                precision=not no_precision,
                engine=engine,
                reduced=reduced,
                robust=function,
            )
            methods = adjusting.Methods("bundle" if by_rays else method, start, degree, polynomials)
            told = Told(
                form,
                control,
                stations,
                control_sigma,
                station_sigma,
                attitude_sigma,
                image_size,
                chunk,
                interior,
                pixel_size,
            )
            sources = importlib.import_module("jaxbundle.cli.source_values").sources_of(told)
            wanted = adjusting.Wanted(
                options,
                stop,
                limit,
                tuple(unknown or ()),
                checkpoint,
                hold_interior,
                methods,
                sources,
                tuple(show or ()),
                write,
                to,
            )
            if len(paths) == 1:
                code = adjusting.run(paths[0], out, wanted, interruption)
            else:
                several = importlib.import_module("jaxbundle.cli.several")
                code = several.run(paths, out, wanted, jobs, interruption)
    except KeyboardInterrupt:
        typer.echo("jaxbundle: interrupted before a step was accepted: no results are written", err=True)
        code = codes.Code.INTERRUPTED
    raise typer.Exit(code)


@app.command(rich_help_panel=_WORK)
def approximate(
    path: Block,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Block folder of the result (default: NAME-approximate).", show_default=False),
    ] = None,
    anew: Annotated[
        bool, typer.Option("--anew", help="Recompute given orientations and points; fixed ones do not change.")
    ] = False,
) -> None:
    """Compute approximate orientations and points from the rays, and write the block with them.

    Exit codes: 0 all images are oriented in one system; 1 some are not, or there are separate parts; 2 bad input.
    """
    raise typer.Exit(_loaded("approximating").run(path, out, anew))


@app.command(rich_help_panel=_CHECK)
def check_partials(draws: Annotated[int, typer.Option(min=1, help="Number of random rays.")] = 100_000) -> None:
    """Check the 18 partial derivatives of the image equations (Text 000) against automatic differentiation."""
    raise typer.Exit(_loaded("checking_partials").run(draws))


@app.command(rich_help_panel=_LEARN)
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results.")] = Path("jaxbundle-demo"),
) -> None:
    """Simulate a strip and a block with known truth, adjust them and compare the results with the truth."""
    raise typer.Exit(_loaded("demo").run(out))


def _completed_pages(incomplete: str) -> list[str]:
    return importlib.import_module("jaxbundle.cli.pages").completed(incomplete)


@app.command(rich_help_panel=_LEARN)
def docs(
    page: Annotated[
        str, typer.Argument(metavar="PAGE", help="Name of the page.", autocompletion=_completed_pages)
    ] = "index",
) -> None:
    """Show a page of the documentation; without a name the index, which lists all pages."""
    importlib.import_module("jaxbundle.cli.pages").show(page)


@app.command(rich_help_panel=_LEARN)
def new(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new or an empty folder.", show_default=False)],
) -> None:
    """Write a small block folder with comments that can be adjusted; then replace its data by your own."""
    importlib.import_module("jaxbundle.cli.pages").new(folder)


@app.command(rich_help_panel=_WORK)
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="A folder of results.", show_default=False)],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another folder of results.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File for the comparison as an HTML page.", show_default=False)
    ] = None,
    surveys: Annotated[
        bool, typer.Option("--surveys", help="Two independent surveys: test which points have displacements.")
    ] = False,
    level: Annotated[float, typer.Option(help="Level of that test, for all points together.")] = 0.05,
) -> None:
    """Compare two results: differences over their standard deviations, settings, findings."""
    importlib.import_module("jaxbundle.cli.comparing").run(first, second, out, surveys, level)


@app.command(rich_help_panel=_WORK)
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of results.", show_default=False)],
    text: Annotated[bool, typer.Option("--text", help="Print the report as text instead.")] = False,
) -> None:
    """Open the report of a folder of results."""
    importlib.import_module("jaxbundle.cli.showing").run(folder, text)


@app.command(rich_help_panel=_WORK)
def convert(
    path: Block,
    out: Annotated[
        Path,
        typer.Argument(
            help="A block folder, or a file whose suffix determines its format: .txt (BAL), .xml, .nvm, .out, .ply ...",
            show_default=False,
        ),
    ],
    to: Annotated[str, typer.Option(help="The format of OUT, if its name does not determine it.", metavar="NAME")] = "",
    form: Form = "",
    control: Control = None,
    stations: Stations = None,
    control_sigma: Sigmas = "",
    station_sigma: Sigmas = "",
    attitude_sigma: AttitudeSigma = None,
    image_size: Size = "",
    chunk: Chunk = "",
    interior: Interior = "",
    pixel_size: PixelSize = None,
) -> None:
    """Convert a block to another format, and report what the new format cannot represent."""
    converting = _loaded("converting")
    told = Told(
        form, control, stations, control_sigma, station_sigma, attitude_sigma, image_size, chunk, interior, pixel_size
    )
    converting.run(path, out, to, importlib.import_module("jaxbundle.cli.source_values").sources_of(told))
