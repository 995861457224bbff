"""A foreign block from several sources: the file itself, and tables of control and of image positions beside it."""

from dataclasses import dataclass
from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.coordinates import metric
from jaxbundle.io.formats.foreign_block import ReadOptions
from jaxbundle.io.formats.ground_control import Positions, read_control, read_positions, with_control, with_stations
from jaxbundle.io.formats.photographs import positions_of_photographs
from jaxbundle.io.formats.registry import Format, read_format


@dataclass(frozen=True)
class Sources:
    """What stands beside a foreign block, and what a user knows of it; sigmas in plan and in height, object unit."""

    format: str = ""
    """Name of the format, where the content fits several or none."""
    control: Path | None = None
    """gcp_list.txt, or a table with point, X, Y, Z and sigmas."""
    stations: Path | None = None
    """Observed projection centres: geo.txt, or a folder with photographs that tell their positions."""
    control_sigma: tuple[float, float] | None = None
    station_sigma: tuple[float, float] | None = None
    options: ReadOptions = ReadOptions()


def read_sources(path: Path, form: Format, sources: Sources) -> Block:
    """The block of a path in a format, with the control and stations of the tables beside it.

    Raises: BlockError with all that is wrong in one of the files.
    """
    foreign = read_format(path, form.name, sources.options)
    control = read_control(sources.control, sources.control_sigma) if sources.control else None
    positions = _positions(sources)
    control, positions = metric(control, positions)
    if control is not None:
        foreign = with_control(foreign, control)
    if positions is not None:
        foreign = with_stations(foreign, positions)
    return assembled(foreign)


def _positions(sources: Sources) -> Positions | None:
    if sources.stations is None:
        return None
    if sources.stations.is_dir():
        return positions_of_photographs(sources.stations)
    return read_positions(sources.stations, sources.station_sigma)
