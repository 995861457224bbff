"""Reads flight.toml, a planned flight and its specification; all problems are reported together."""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from jaxbundle.block.problems import shown
from jaxbundle.io.block_toml import hidden_texts, line_of, parsed_toml, value_in_words
from jaxbundle.io.flight_settings import (
    SECTIONS,
    ControlSection,
    FlightSettings,
    NavigationSection,
    TerrainSection,
    meant,
)
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import read_text
from jaxbundle.planning.accuracy import Specification
from jaxbundle.planning.flight import ControlSet, FlightPlan, GrossErrors, Navigation, Terrain, Ties
from jaxbundle.planning.terrain import grid_heights, slope, waves

EXAMPLES = {
    "camera": '[camera] name = "film-153", or principal_distance, width and height in mm',
    "flight": "[flight] height = 1500.0, strips = 3, images = 8",
    "sigma": "sigma = 0.02, or three numbers for X, Y, Z; 0 for coordinates without errors",
    "layout": 'layout = "perimeter"',
    "image": "image = 0.3, in px, or in mm for a camera without pixel_size",
    "xy": "xy = 0.02, in metres",
    "z": "z = 0.03, in metres",
    "share": "share = 0.01",
}


class PlannedFlight(NamedTuple):
    """The flight of a file, and its specification, if there is one."""

    plan: FlightPlan
    specification: Specification | None


def read_flight(path: str | Path) -> PlannedFlight:
    r"""Reads a planned flight from a file.

    Args:
        path: flight.toml, or a folder that contains it.

    Returns: the flight and its specification.

    Raises: BlockError with all problems of the file, each with its line and its cure.

    Example:
        >>> text = '[camera]\nname = "film-153"\n[flight]\nstrips = 2\nimages = 5\nheight = 900\n'
        >>> _ = Path("flight.toml").write_text(text)
        >>> jb.io.read_flight("flight.toml").plan.strips
        2
    """
    file, noted = Path(path), Noted()
    file = file / "flight.toml" if file.is_dir() else file
    if not file.exists():
        noted.add(str(path), 0, "there is no such file", "give the path of a flight.toml, or of its folder")
        raise noted.error()
    text = read_text(file, noted)
    raw = parsed_toml(file.name, text, noted) if text is not None else None
    settings = _settings(file.name, text, raw, noted) if text is not None and raw is not None else None
    terrain = _terrain(settings.terrain, file, text or "", noted) if settings else None
    if noted or settings is None or terrain is None:
        raise noted.error()
    wanted = settings.specification
    return PlannedFlight(_plan(settings, terrain), Specification(wanted.xy, wanted.z, wanted.share) if wanted else None)


def _settings(file: str, text: str, raw: dict[str, Any], noted: Noted) -> FlightSettings | None:
    for where in hidden_texts(raw):
        what = f"{' '.join(map(shown, where))} has an invisible character"
        noted.add(file, line_of(text, where), what, "delete this character")
    try:
        return FlightSettings.model_validate(raw)
    except ValidationError as error:
        told = [(_line(text, detail["loc"]), *_in_words(detail)) for detail in error.errors(include_url=False)]
        for line, what, cure in dict.fromkeys(told):
            noted.add(file, line, what, cure)
    return None


def _line(text: str, loc: tuple[int | str, ...]) -> int:
    """The line of a key; for [[control]], in the section with its number."""
    names = tuple(part for part in loc if isinstance(part, str))
    number = next((part for part in loc if isinstance(part, int)), None)
    if loc[0] != "control" or number is None:
        return line_of(text, names)
    headers = [k for k, line in enumerate(text.split("\n")) if re.match(r"\s*\[\[\s*control\s*\]\]", line)]
    if number >= len(headers):
        return line_of(text, names)
    ends = [*headers, text.count("\n") + 1][number + 1]
    part = "\n".join(text.split("\n")[headers[number] : ends])
    return headers[number] + max(line_of(part, names), 1)


def _in_words(error: ErrorDetails) -> tuple[str, str]:
    loc = tuple(str(part) for part in error["loc"] if isinstance(part, str))
    key = loc[-1]
    where = f"[{loc[0]}] {shown(key)}" if len(loc) > 1 else f"[{key}]" if key in SECTIONS else shown(key)
    if error["type"] == "missing":
        example = EXAMPLES.get(key, "")
        return f"{where} is missing", f"add it, such as {example}" if example else "add it"
    if error["type"] == "extra_forbidden":
        known = tuple((SECTIONS[loc[0]] if len(loc) > 1 else FlightSettings).model_fields)
        return f"{where} is unknown", f"{meant(key, known)}known keys: {', '.join(known)}"
    if error["type"] in ("too_short", "too_long"):
        length = error.get("ctx", {}).get("min_length", error.get("ctx", {}).get("max_length"))
        return f"{where} has {len(error['input'])} elements", f"give {length}, in brackets"
    return value_in_words(error, loc)


def _terrain(section: TerrainSection, file: Path, text: str, noted: Noted) -> Terrain | None:
    if section.type == "random":
        return Terrain(section.relief or 0.0)
    if section.type == "waves":
        return Terrain(heights=waves(section.relief or 0.0, section.wavelength or 1.0))
    if section.type == "slope":
        x, y = section.slope or (0.0, 0.0)
        return Terrain(heights=slope(x, y))
    if section.type == "flat" or section.file is None:
        return Terrain()
    try:
        grid = np.loadtxt(file.parent / section.file, delimiter=",", skiprows=1, ndmin=2)
        if grid.shape[1] != 3:
            raise ValueError(f"there are {grid.shape[1]} columns")
        return Terrain(heights=grid_heights(grid))
    except (OSError, ValueError) as error:
        what = f"[terrain] file {shown(section.file)} cannot be used: {shown(str(error), 200)}"
        noted.add(file.name, line_of(text, ("terrain", "file")), what, "give a CSV with one header line and X, Y, Z")
    return None


def _plan(s: FlightSettings, terrain: Terrain) -> FlightPlan:
    """The flight of complete settings."""
    camera, f = s.camera.camera, s.flight
    unit = camera.pixel_size
    height = f.height or (f.scale or 0.0) * camera.principal_distance / 1000
    if f.gsd:
        height = f.gsd * camera.principal_distance / (unit or 1.0)
    places = tuple((x, y) for x, y in s.check.points)
    return FlightPlan(
        strips=f.strips or 1,
        images=f.images or 2,
        camera=camera,
        height=height,
        forward_overlap=f.forward_overlap,
        side_overlap=f.side_overlap,
        headings=tuple(math.radians(h) for h in f.headings),
        origin=(f.origin[0], f.origin[1]),
        area=tuple((x, y) for x, y in f.area or ()),
        cross_strips=tuple(f.cross_strips),
        back_and_forth=f.back_and_forth,
        tilt=math.radians(f.tilt),
        scatter=f.scatter,
        terrain=terrain,
        ties=Ties(s.ties.layout, s.ties.points_per_image, s.ties.rows),
        image_sigma=s.sigma.image if s.sigma else None,
        control=tuple(map(_control, s.control)),
        check_points=places or s.check.count,
        gnss=_navigation(s.gnss, s.gnss.lever_arm, 1.0) if s.gnss else None,
        ins=_navigation(s.ins, s.ins.boresight, math.radians(1.0)) if s.ins else None,
        gross_errors=GrossErrors(s.gross_errors.share, s.gross_errors.size) if s.gross_errors else GrossErrors(),
        noise=s.noise,
        seed=s.seed,
        name=s.name,
    )


def _control(section: ControlSection) -> ControlSet:
    x, y, z = section.sigma
    points = tuple((a, b) for a, b in section.points)
    return ControlSet(section.layout, section.kind, (x, y, z), section.count, section.every, points)


def _navigation(section: NavigationSection, offset: list[float] | None, unit: float) -> Navigation:
    x, y, z = (unit * sigma for sigma in section.sigma)
    a, b, c = (unit * value for value in offset or (0.0, 0.0, 0.0))
    size = unit * section.shift, unit * section.drift
    return Navigation((x, y, z), section.systematic, *size, (a, b, c), section.estimate_offset)
