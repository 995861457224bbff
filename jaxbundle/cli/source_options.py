"""Options about projects of other programs, as the command line has them."""

from pathlib import Path
from typing import NamedTuple


class Told(NamedTuple):
    """Options in text; `sources.sources_of` makes values of them."""

    form: str = ""
    control: Path | None = None
    stations: Path | None = None
    control_sigma: str = ""
    station_sigma: str = ""
    attitude_sigma: float | None = None
    image_size: str = ""
    chunk: str = ""
    interior: str = ""
    pixel_size: float | None = None
