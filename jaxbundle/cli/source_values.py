"""Conversion of the options about projects of other programs."""

import math

import typer

from jaxbundle.cli.source_options import Told
from jaxbundle.io import Sources
from jaxbundle.io.formats.foreign_block import ReadOptions


def sources_of(told: Told) -> Sources:
    """The sources of the options.

    Raises: typer.BadParameter for text that is not a pair of numbers.
    """
    size = _pair("--image-size", told.image_size)
    return Sources(
        told.form,
        told.control,
        told.stations,
        _pair("--control-sigma", told.control_sigma),
        _pair("--station-sigma", told.station_sigma),
        _positive("--attitude-sigma", told.attitude_sigma),
        ReadOptions(
            None if size is None else (round(size[0]), round(size[1])),
            _interior(told.interior),
            _positive("--pixel-size", told.pixel_size),
            told.chunk,
        ),
    )


def _positive(option: str, value: float | None) -> float | None:
    if value is not None and not 0 < value < math.inf:
        raise typer.BadParameter(f"{option} {value} is not a positive number")
    return value


def _interior(text: str) -> tuple[float, float, float] | None:
    """Principal distance and principal point; None if not given."""
    if not text:
        return None
    try:
        f, x0, y0 = (float(field) for field in text.split(","))
    except ValueError:
        f = x0 = y0 = math.nan
    if not (0 < f < math.inf and math.isfinite(x0 + y0)):
        raise typer.BadParameter(f"--interior {text} is not F,X0,Y0 in px, such as 20656.5,4430,6468")
    return f, x0, y0


def _pair(option: str, text: str) -> tuple[float, float] | None:
    """Two positive numbers, or one for both; None if not given."""
    if not text:
        return None
    try:
        values = [float(field) for field in text.replace("x", ",").split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0 < value < math.inf for value in values):
        raise typer.BadParameter(f"{option} {text} is not one or two positive numbers, such as 0.05,0.1")
    return values[0], values[-1]
