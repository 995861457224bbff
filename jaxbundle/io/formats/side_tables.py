"""A foreign block from several sources: the file itself, and additional tables of control and of image positions."""

from dataclasses import dataclass, replace
from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.attitudes import observed_attitudes
from jaxbundle.io.formats.coordinates import metric
from jaxbundle.io.formats.foreign_block import ReadOptions
from jaxbundle.io.formats.format_table import Format, read_format
from jaxbundle.io.formats.ground_control import Positions, read_control, read_positions, with_control, with_stations
from jaxbundle.io.formats.photograph_data import positions_of_photographs


@dataclass(frozen=True)
class Sources:
    """Additional tables of a foreign block, and information from the user; sigmas in plan and height, object unit.

    Example:
        >>> jb.io.Sources(control=Path("gcp_list.txt"), control_sigma=(0.02, 0.03)).control_sigma
        (0.02, 0.03)
    """

    format: str = ""
    """Name of the format, for content that fits several formats or none."""
    control: Path | None = None
    """gcp_list.txt, or a table with point, X, Y, Z and sigmas."""
    stations: Path | None = None
    """Observed projection centres: geo.txt, or a folder with photographs that have positions."""
    control_sigma: tuple[float, float] | None = None
    station_sigma: tuple[float, float] | None = None
    attitude_sigma: float | None = None
    """Standard deviation of observed attitudes in degrees; None: attitudes of the stations are not used."""
    options: ReadOptions = ReadOptions()


def read_sources(path: Path, form: Format, sources: Sources) -> Block:
    """Reads the block of a path in a format, with control and stations of the additional tables.

    Raises: BlockError with all problems in one of the files.
    """
    foreign = read_format(path, form.name, sources.options)
    control = read_control(sources.control, sources.control_sigma) if sources.control else None
    positions = _positions(sources)
    control, positions = metric(control, positions)
    if control is not None:
        foreign = with_control(foreign, control)
    if positions is not None:
        foreign = with_stations(foreign, _attitudes_observed(positions, sources.attitude_sigma))
    return assembled(foreign)


def _attitudes_observed(positions: Positions, sigma: float | None) -> Positions:
    """Positions with attitudes as observations of omega, phi, kappa, or a finding that these are not used."""
    if not positions.attitudes:
        return positions
    if sigma is None:
        what = (
            f"the attitudes of {len(positions.attitudes)} images are not used, as their standard deviation is not known"
        )
        note = Finding(Kind.INFORMATION, what, "give it with --attitude-sigma, in degrees")
        return replace(positions, attitudes=(), findings=(*positions.findings, note))
    system = positions.coordinate_system
    return replace(positions, attitudes=observed_attitudes(positions.attitudes, positions.stations, system, sigma))


def _positions(sources: Sources) -> Positions | None:
    if sources.stations is None:
        return None
    if sources.stations.is_dir():
        return positions_of_photographs(sources.stations)
    return read_positions(sources.stations, sources.station_sigma)
