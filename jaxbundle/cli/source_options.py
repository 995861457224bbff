"""Options about projects of other programs as text of the command line."""

from pathlib import Path
from typing import NamedTuple


class Told(NamedTuple):
    """Options as text; `sources.sources_of` converts them to values."""

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
