"""The commands `jaxbundle measure` and `jaxbundle pyramid`: from photographs to rays.

The modules of the measurement are imported when a command is called.
"""

import importlib
from pathlib import Path
from typing import Annotated

import typer


def pyramid(
    paths: Annotated[list[Path], typer.Argument(metavar="IMAGES", help="JPEG, PNG or TIFF.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the pyramids.")] = Path("pyramids"),
    zlib: Annotated[bool, typer.Option("--zlib", help="Compress the tiles: smaller files, slower windows.")] = False,
) -> None:
    """Make image pyramids: tiled TIFF with one sub-image for each level; later commands reuse them."""
    measuring = importlib.import_module("jaxbundle.cli.pyramids")
    raise typer.Exit(measuring.run(paths, out, "zlib" if zlib else None))


def measure(
    images: Annotated[
        list[Path] | None, typer.Argument(metavar="IMAGES", help="Photographs, or folders of them.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The block folder to write.")] = Path("block"),
    refine: Annotated[
        Path | None,
        typer.Option(metavar="BLOCK", help="Remeasure the rays of this block; needs --images.", show_default=False),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--images", metavar="DIR", help="Folder of the images of --refine.", show_default=False),
    ] = None,
    pyramids: Annotated[
        Path | None,
        typer.Option(help="Folder of the image pyramids (default: in the folder of the images).", show_default=False),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Stations: image,latitude,longitude,altitude (default: EXIF, XMP).", show_default=False
        ),
    ] = None,
    principal_distance: Annotated[
        float | None, typer.Option(metavar="PX", help="Approximate principal distance.", show_default=False)
    ] = None,
    sensor_width: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Width of the sensor, with the focal length of EXIF.", show_default=False),
    ] = None,
    level: Annotated[int, typer.Option(min=0, help="Level of the pyramids for the detection of points.")] = 1,
    points: Annotated[int, typer.Option(min=64, help="Maximum number of points detected in an image.")] = 2048,
    control: Annotated[
        Path | None,
        typer.Option(help="Control with marks in the photographs: gcp_list.txt.", show_default=False),
    ] = None,
    remeasure: Annotated[
        bool, typer.Option("--remeasure", help="Remeasure the marks of --control by matching.")
    ] = False,
    attitude_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Standard deviation of the attitudes in the XMP data, which are not used without it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Measure tie points in photographs and write a block folder, or remeasure the rays of a block."""
    importlib.import_module("jaxbundle.cli.runtime").start()
    measuring = importlib.import_module("jaxbundle.cli.measuring")
    if refine is not None:
        if folder is None or images:
            raise typer.BadParameter("--refine BLOCK needs --images DIR, and no other images")
        raise typer.Exit(measuring.run_refining(refine, folder, out, pyramids))
    if not images:
        raise typer.BadParameter("give photographs or folders of them")
    if remeasure and control is None:
        raise typer.BadParameter("--remeasure needs --control; --refine BLOCK remeasures all rays of a block")
    wanted = measuring.Wanted(
        images,
        out,
        pyramids,
        positions,
        principal_distance,
        sensor_width,
        level,
        points,
        control,
        remeasure,
        attitude_sigma,
    )
    raise typer.Exit(measuring.run(wanted))
