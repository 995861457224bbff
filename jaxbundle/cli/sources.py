"""Options about projects of other programs, as values."""

import math

import typer

from jaxbundle.cli.told import Told
from jaxbundle.io import Sources
from jaxbundle.io.formats.foreign_block import ReadOptions


def sources_of(told: Told) -> Sources:
    """The sources that options name.

    Raises: typer.BadParameter for a pair that is none.
    """
    size = _pair("--image-size", told.image_size)
    return Sources(
        told.form,
        told.control,
        told.stations,
        _pair("--control-sigma", told.control_sigma),
        _pair("--station-sigma", told.station_sigma),
        ReadOptions(None if size is None else (round(size[0]), round(size[1])), told.chunk),
    )


def _pair(option: str, text: str) -> tuple[float, float] | None:
    """Two positive numbers, or one for both; None where nothing is given."""
    if not text:
        return None
    try:
        values = [float(field) for field in text.replace("x", ",").split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0 < value < math.inf for value in values):
        raise typer.BadParameter(f"{option} {text} is not one or two positive numbers, such as 0.05,0.1")
    return values[0], values[-1]
