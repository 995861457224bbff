"""The command `jaxbundle measure`: measures photographs to a block folder, or remeasures the rays of a block."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import typer

from jaxbundle.block.findings import in_order
from jaxbundle.cli.codes import BadInput, Code
from jaxbundle.cli.progress import Phases
from jaxbundle.imagery.match_types import Refusal
from jaxbundle.imagery.pyramid_file import pyramid
from jaxbundle.imagery.refinement import refine
from jaxbundle.io import read, write_block_folder
from jaxbundle.measuring.measurement import CameraGiven, MeasureOptions, measure
from jaxbundle.measuring.photo_set import read_positions
from jaxbundle.report.text import wrapped

INDENT = 10  # words for severities, as in reports
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


class Wanted(NamedTuple):
    """Options of the user."""

    images: list[Path]
    out: Path
    pyramids: Path | None = None
    positions: Path | None = None
    principal_distance: float | None = None
    sensor_width: float | None = None
    level: int = 1
    number: int = 2048
    control: Path | None = None
    remeasure: bool = False
    attitude_sigma: float | None = None


def run(wanted: Wanted) -> int:
    """Measures photographs and writes the block folder.

    Raises: ImageError for images that cannot be used, BadInput where the folder has other files.
    """
    _require_new(wanted.out)
    paths = [path for given in wanted.images for path in (_images_in(given) if given.is_dir() else [given])]
    camera = CameraGiven(wanted.principal_distance, wanted.sensor_width)
    options = MeasureOptions(
        wanted.level,
        wanted.number,
        camera,
        pyramids=wanted.pyramids,
        control=wanted.control,
        remeasure=wanted.remeasure,
        attitude_sigma=wanted.attitude_sigma,
    )
    positions = None if wanted.positions is None else read_positions(wanted.positions)
    with Phases() as phases:
        found = measure(paths, wanted.out, options, positions=positions, tell=phases.tell)
    rays = found.rays
    images, points = len(np.unique(rays.image)), int(rays.point.max(initial=-1)) + 1
    typer.echo(f"{images} of {len(paths)} images, {points} points, {len(rays.image)} rays")
    _echo_refused(rays.refused)
    for finding in in_order(found.findings):
        typer.echo("\n".join(wrapped(finding.severity.label, finding.words, INDENT)))
    typer.echo(f"Block: {wanted.out}")
    return Code.ADJUSTED


def run_refining(block_path: Path, folder: Path, out: Path, pyramids: Path | None) -> int:
    """Remeasures the rays of a block and writes it as a block folder.

    Raises: BlockError, ImageError, BadInput.
    """
    _require_new(out)
    block = read(block_path)
    there = {path.name: path for path in _images_in(folder)} | {path.stem: path for path in _images_in(folder)}
    images = {}
    with Phases() as phases:
        for name in block.structure.image_names:
            if name in there:
                phases.tell(f"pyramid of {name}")
                images[name] = pyramid(there[name], pyramids)
        phases.tell("matching")
        found = refine(block, images)
    write_block_folder(found.block, out)
    measured, tried = int(found.matches.matched.sum()), len(found.rays)
    typer.echo(f"{len(images)} of {len(block.structure.image_names)} images; {measured} of {tried} rays remeasured")
    _echo_refused({reason: number for reason, number in found.counts.items() if reason != Refusal.MATCHED})
    typer.echo(f"Block: {out}")
    return Code.ADJUSTED


def _echo_refused(refused: dict[Refusal, int]) -> None:
    for reason, number in sorted(refused.items(), key=lambda item: -item[1]):
        if number:
            typer.echo(f"  {number} refused: {reason.words}")


def _images_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise BadInput(f"{folder} is not a folder; give the folder of the images")
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


def _require_new(out: Path) -> None:
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BadInput(f"{out} exists; give the name of a new folder")
