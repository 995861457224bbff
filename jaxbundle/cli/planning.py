"""The command `jaxbundle plan`: accuracy before the flight. This module has the options; `planning_runs` the work."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup


class _WithDefault(TyperGroup):
    """Makes `plan FLIGHT` a short form of `plan flight FLIGHT`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            args = ["flight", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_WithDefault,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Accuracy before the flight: laws, prediction, simulation, design of control. `plan FLIGHT` predicts.",
)

Flight = Annotated[Path, typer.Argument(metavar="FLIGHT", help="A flight.toml, or its folder.", show_default=False)]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder of the results.")]
Three = tuple[float, float, float]


def _loaded() -> ModuleType:
    """Imports the module of the commands after the set-up of JAX."""
    importlib.import_module("jaxbundle.cli.runtime").start()
    return importlib.import_module("jaxbundle.cli.planning_runs")


@app.command()
def flight(path: Flight, out: Out = Path("plan")) -> None:
    """Predict the accuracy of a flight, without noise and without a solve.

    Exit code 1 if unknowns are not determined or the specification is not met.
    """
    raise typer.Exit(_loaded().flight(path, out))


@app.command()
def simulate(path: Flight, out: Out = Path("simulated")) -> None:
    """Simulate a flight: writes a block folder to adjust, and the true values."""
    raise typer.Exit(_loaded().simulate(path, out))


@app.command()
def control(
    path: Flight,
    points: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of control points; default: the minimum number that meets the specification.",
            show_default=False,
        ),
    ] = None,
    sigma: Annotated[Three, typer.Option(metavar="X Y Z", help="Standard deviations of the control points, m.")] = (
        0.02,
        0.02,
        0.02,
    ),
    kind: Annotated[Literal["full", "plan", "height"], typer.Option(help="Kind of control.")] = "full",
    criterion: Annotated[
        Literal["mean", "worst"],
        typer.Option(help="Quantity to minimise: the mean variance, or the maximum variance of a point."),
    ] = "mean",
    candidates: Annotated[int, typer.Option(min=3, help="Number of candidate positions.")] = 120,
    out: Out = Path("plan-control"),
) -> None:
    """Optimise positions of control points: exchange on the covariance, with a lower bound of all layouts.

    Control of the flight is not changed; the new points are added to it.
    """
    raise typer.Exit(_loaded().control(path, points, (sigma, kind, criterion, candidates), out))


@app.command()
def monte_carlo(
    path: Flight,
    draws: Annotated[int, typer.Option(min=20, help="Number of adjustments.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random errors.")] = 0,
) -> None:
    """Adjust a flight many times with other errors, and test the scatter against the prediction."""
    raise typer.Exit(_loaded().monte_carlo(path, draws, seed))


@app.command()
def design(path: Flight) -> None:
    """Derivatives of the mean variance with respect to control, sigmas, overlaps and height."""
    raise typer.Exit(_loaded().design(path))


@app.command()
def sensitivity(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A block folder or a BAL file.", show_default=False)],
    point: Annotated[str, typer.Option(help="Name of the object point.", show_default=False)],
    coordinate: Annotated[Literal["X", "Y", "Z"], typer.Option(help="Coordinate of the point.")] = "Z",
    rows: Annotated[int, typer.Option(min=1, help="Number of rows of the table.")] = 15,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="File for all rows, CSV; also writes a map of them as SVG.", show_default=False
        ),
    ] = None,
) -> None:
    """Sensitivity of an adjusted coordinate to each observation, control coordinate and calibration value."""
    raise typer.Exit(_loaded().sensitivity_of(path, point, coordinate, rows, out))


@app.command()
def laws(
    scale: Annotated[float, typer.Option(help="Scale number m.")] = 10000.0,
    parallax: Annotated[float, typer.Option(help="Standard deviation of a parallax, mm.")] = 0.01,
    principal_distance: Annotated[float, typer.Option(help="f, mm.")] = 153.0,
    base: Annotated[float, typer.Option(help="Base at photo scale, mm.")] = 92.0,
    pairs: Annotated[int, typer.Option(min=1, help="Number of stereopairs.")] = 10,
    tolerance: Annotated[
        Three | None,
        typer.Option(metavar="X Y Z", help="Maximum standard deviations in the middle, m.", show_default=False),
    ] = None,
) -> None:
    """Laws of accumulation along a strip, and the distance between control for a tolerance."""
    raise typer.Exit(_loaded().laws(scale, parallax, (principal_distance, base), pairs, tolerance))
