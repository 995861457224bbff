"""Options and arguments that several commands share, with their help."""

from pathlib import Path
from typing import Annotated, Literal

import typer

SOLVER = "Solver"  # headings in the help of adjust
CLUSTER = "Cluster: one block on several machines"
_A_BLOCK = "a block folder, a BAL file, or a project of another program, recognised by content"
Block = Annotated[Path, typer.Argument(metavar="PATH", help=f"{_A_BLOCK.capitalize()}.", show_default=False)]
Blocks = Annotated[list[Path], typer.Argument(metavar="PATH", help=f"Blocks: each {_A_BLOCK}.", show_default=False)]
_SOURCES = "Projects of other programs"
Form = Annotated[
    str,
    typer.Option(
        "--format",
        help="The format of PATH, if its content fits several formats.",
        rich_help_panel=_SOURCES,
        metavar="NAME",
    ),
]
Control = Annotated[
    Path | None,
    typer.Option(help="Control: gcp_list.txt, or a table point,X,Y,Z,sX,sY,sZ.", rich_help_panel=_SOURCES),
]
Stations = Annotated[
    Path | None,
    typer.Option(help="Observed projection centres: geo.txt, or a folder with photographs.", rich_help_panel=_SOURCES),
]
Sigmas = Annotated[
    str,
    typer.Option(
        metavar="PLAN,HEIGHT", help="Standard deviations of a table that has none, in m.", rich_help_panel=_SOURCES
    ),
]
AttitudeSigma = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="Use the attitudes of the table of stations as observations with this standard deviation.",
        rich_help_panel=_SOURCES,
    ),
]
Size = Annotated[
    str,
    typer.Option(
        metavar="W,H",
        help="True size of the images in px, for formats that do not contain it.",
        rich_help_panel=_SOURCES,
    ),
]
Interior = Annotated[
    str,
    typer.Option(
        metavar="F,X0,Y0",
        help="Interior orientation in px, for formats that do not contain it.",
        rich_help_panel=_SOURCES,
    ),
]
PixelSize = Annotated[
    float | None,
    typer.Option(
        metavar="MM", help="Pixel size in mm, for image coordinates in mm without one.", rich_help_panel=_SOURCES
    ),
]
Chunk = Annotated[
    str, typer.Option(help="Label of the chunk to read from a Metashape project.", rich_help_panel=_SOURCES)
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="Folder of the results (default: NAME-adjusted; several blocks: adjustments, one folder per block).",
        show_default=False,
    ),
]
Stop = Annotated[
    Literal["angle", "points", "parallax", "unknown"],
    typer.Option(
        rich_help_panel=SOLVER,
        help="Stopping rule: angle between the residuals and the tangent plane; maximum change of a point"
        " coordinate; decrease of the maximum y-parallax; maximum change of the named unknowns.",
    ),
]
Limit = Annotated[
    float | None,
    typer.Option(
        help="Limit of the stopping rule: object unit for points, fraction of the principal distance for parallax,"
        " unit of the unknown (angles in radians); default: 1e-8 for angle.",
        show_default=False,
        rich_help_panel=SOLVER,
    ),
]
Unknown = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME:ELEMENT", help="Unknown of --stop unknown; may be repeated.", rich_help_panel=SOLVER),
]
Coordinator = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Address of process 0 of a cluster, the same for all processes, in a trusted network; auto: from Slurm,"
        " Open MPI or Kubernetes.",
        show_default=False,
        rich_help_panel=CLUSTER,
    ),
]
RobustLimit = Annotated[
    float | None,
    typer.Option(
        metavar="K",
        help="Limit of the weight function, in standard deviations (default: that of the function).",
        show_default=False,
    ),
]
Exports = Annotated[
    list[Path] | None,
    typer.Option(
        "--export",
        metavar="FILE",
        help="Points, images, residual vectors and error ellipses for other programs: .ply, .las, .laz, .geojson,"
        " .gpkg, .kml or .dxf; may be repeated.",
        show_default=False,
    ),
]
