"""Options and arguments that several commands share, with their help."""

from pathlib import Path
from typing import Annotated

import typer

_A_BLOCK = "a block folder, a BAL file, or a project of another program, told apart by content"
Block = Annotated[Path, typer.Argument(metavar="PATH", help=f"{_A_BLOCK.capitalize()}.", show_default=False)]
Blocks = Annotated[list[Path], typer.Argument(metavar="PATH", help=f"Blocks: each {_A_BLOCK}.", show_default=False)]
_SOURCES = "Projects of other programs"
Form = Annotated[
    str,
    typer.Option(
        "--format", help="The format of PATH, where its content fits several.", rich_help_panel=_SOURCES, metavar="NAME"
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
Size = Annotated[
    str,
    typer.Option(
        metavar="W,H", help="True size of the images in px, of formats that do not have it.", rich_help_panel=_SOURCES
    ),
]
Interior = Annotated[
    str,
    typer.Option(
        metavar="F,X0,Y0", help="Interior orientation in px, of formats that do not have it.", rich_help_panel=_SOURCES
    ),
]
PixelSize = Annotated[
    float | None,
    typer.Option(
        metavar="MM", help="Size of a pixel, of image coordinates in mm without one.", rich_help_panel=_SOURCES
    ),
]
Chunk = Annotated[str, typer.Option(help="Label of the chunk of a Metashape project.", rich_help_panel=_SOURCES)]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="Folder of the results (default: NAME-adjusted; several blocks: adjustments, one folder per block).",
        show_default=False,
    ),
]
