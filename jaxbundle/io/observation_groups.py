"""From the rows of a block folder's tables to groups of observations, and the parameters they bring along.

What the tables do not tell is NaN, and found from approximate coordinates (approximate/figures.py): the orientations of
sets of directions, planes and lines.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxbundle.block.block import Owner, Parameter
from jaxbundle.block.geodetic import ANGLES, FRAME, LINES, PLANES, geodetic_kind
from jaxbundle.block.navigation import ATTITUDES, GNSS
from jaxbundle.block.observations import (
    CONTROL,
    PARAMETERS,
    STATIONS,
    ObservationGroup,
    ObservationKind,
    interior_priors,
    observation_group,
)
from jaxbundle.block.wording import RADIANS
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_toml import BlockToml
from jaxbundle.io.folder_tables import FolderTables, KnownRows
from jaxbundle.io.navigation_tables import DRIFTS, KINDS, section_of
from jaxbundle.io.observation_tables import PAIRS, FigureRows, PairRows
from jaxbundle.io.settings import OF_ATTITUDES, CameraSection, Settings

FRAME_NAMES = {"planes": ("a", "b", "d"), "lines": ("a", "b", "p", "q")}
PREFIX = {"directions": "orientation of set ", "scale_bars": "length of bar "}
ENDS = ("point", "image")
PAIR_TYPES = ((False, False), (False, True), (True, False), (True, True))  # order of the groups of one table


@dataclass
class Found:
    """Groups and parameters found so far; values of angles in radians; `priors`: parameter, value, sigma."""

    groups: list[ObservationGroup] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    priors: list[tuple[int, float, float]] = field(default_factory=list)

    def add(self, parameter: Parameter, value: float, sigma: float = np.nan) -> int:
        """Adds a parameter, observed where it has a sigma; its number."""
        number = len(self.parameters)
        self.parameters.append(parameter)
        self.values.append(value)
        if sigma > 0:
            self.priors.append((number, value, sigma))
        return number


def found_in(tables: FolderTables, toml: BlockToml, settings: Settings) -> Found:
    """All observations of the tables that are no rays, as far as there are any, and their parameters."""
    found = Found()
    if "control" in tables.known and len(tables.known["control"].members):
        found.groups.append(_coordinate_group(CONTROL, tables.known["control"]))
    _plain_stations(found, tables)
    for kind in PAIRS:
        if kind in tables.pairs:
            _pairs(found, kind, tables.pairs[kind], tables, settings)
    for kind, add in (("plumb_lines", _plumb_lines), ("planes", _on_figures), ("lines", _on_figures)):
        if kind in tables.figures:
            add(found, kind, tables.figures[kind], settings.units.object)
    for kind in KINDS:
        _navigation(found, kind, tables, toml, settings)
    if found.priors:
        numbers, values, sigmas = zip(*found.priors, strict=True)
        found.groups.append(_column(PARAMETERS, np.array(numbers)[:, None], np.array(values), np.array(sigmas)))
    return found


def _column(kind: ObservationKind, indices: np.ndarray, values: np.ndarray, sigmas: np.ndarray) -> ObservationGroup:
    return observation_group(kind, indices, np.asarray(values)[:, None], np.asarray(sigmas)[:, None])


def _coordinate_group(kind: ObservationKind, rows: KnownRows, members: np.ndarray | None = None) -> ObservationGroup:
    members = rows.members if members is None else members
    values = np.where(rows.observed, rows.coordinates, np.nan)[members]
    covariances = None if rows.covariances is None else rows.covariances[members]
    return observation_group(kind, rows.position[members, None], values, rows.sigmas[members], None, covariances)


def _plain_stations(found: Found, tables: FolderTables) -> None:
    """Stations without systematic errors: those of no group."""
    if "stations" in tables.known:
        rows = tables.known["stations"]
        members = rows.members[tables.navigation.rows["stations"].group[rows.members] < 0]
        if len(members):
            found.groups.append(_coordinate_group(STATIONS, rows, members))


def _pairs(found: Found, kind: str, rows: PairRows, tables: FolderTables, settings: Settings) -> None:
    """Observations between two ends: a group for each sort of ends."""
    unit = settings.units.angle
    factor = RADIANS[unit] if kind in ANGLES else 1.0
    used = rows.usable & np.isfinite(rows.values).all(1)
    owners: dict[int, int] = {}
    for k in dict.fromkeys(sorted(rows.owner[used].tolist())) if kind in PREFIX else ():
        name = PREFIX[kind] + rows.owners[k]
        if kind == "directions":
            owners[k] = found.add(Parameter(name, unit, angle=True, owner=Owner("sets", rows.owners[k])), np.nan)
        else:
            assert tables.bars is not None
            length, sigma = float(tables.bars.lengths[k]), float(tables.bars.sigmas[k])
            owners[k] = found.add(
                Parameter(name, settings.units.object, sigma != 0, owner=Owner("bars", rows.owners[k])), length, sigma
            )
    for ends in PAIR_TYPES:
        members = np.flatnonzero(used & (rows.is_image == ends).all(1))
        if len(members):
            indices = rows.indices[members]
            if kind in PREFIX:
                indices = np.c_[indices, [owners[k] for k in rows.owner[members].tolist()]]
            observed = geodetic_kind(kind, *(ENDS[is_image] for is_image in ends))
            values, sigmas = factor * rows.values[members], factor * rows.sigmas[members]
            found.groups.append(observation_group(observed, indices, values, sigmas))


def _plumb_lines(found: Found, kind: str, rows: FigureRows, unit: str) -> None:
    """Every point against the first one of its line."""
    pairs, sigmas = [], []
    usable = np.flatnonzero(rows.usable)
    order = usable[np.argsort(rows.figure[usable], kind="stable")]
    starts = np.flatnonzero(np.diff(rows.figure[order], prepend=-1))
    for members in np.split(order, starts[1:]) if len(order) else ():
        first, *others = members.tolist()
        pairs += [(rows.point[first], rows.point[row]) for row in others]
        sigmas += [rows.sigmas[row] for row in others]
    if pairs:
        both = np.repeat(np.array(sigmas)[:, None], 2, 1)
        found.groups.append(observation_group(geodetic_kind(kind), np.array(pairs), np.zeros_like(both), both))


def _on_figures(found: Found, kind: str, rows: FigureRows, unit: str) -> None:
    """Points on planes or lines, which are fitted once the points have coordinates."""
    members = np.flatnonzero(rows.usable)
    if not len(members):
        return
    units = {"a": "", "b": "", "d": unit, "p": unit, "q": unit}
    numbers = {
        k: [
            found.add(
                Parameter(f"{n} of {kind[:-1]} {rows.figures[k]}", units[n], owner=Owner(kind, rows.figures[k])), np.nan
            )
            for n in FRAME_NAMES[kind]
        ]
        for k in dict.fromkeys(rows.figure[members].tolist())
    }
    observed = PLANES if kind == "planes" else LINES
    indices = np.array([[rows.point[row], *numbers[rows.figure[row]]] for row in members.tolist()])
    sigmas = np.repeat(rows.sigmas[members, None], len(observed.components), 1)
    frames = np.full((len(members), len(FRAME)), np.nan)
    found.groups.append(observation_group(observed, indices, np.zeros_like(sigmas), sigmas, frames))


def _navigation(found: Found, kind: str, tables: FolderTables, toml: BlockToml, settings: Settings) -> None:
    """Stations of groups, or attitudes: nine parameters a group, of which a few are unknown."""
    if kind not in tables.known:
        return
    known, rows = tables.known[kind], tables.navigation.rows[kind]
    members = known.members
    members = members if kind == "attitudes" else members[rows.group[members] >= 0]
    if not len(members):
        return
    angles = kind == "attitudes"
    factor = RADIANS[settings.units.angle] if angles else 1.0
    axes = settings.rotation.system
    numbers = {
        k: _navigation_parameters(found, kind, tables.navigation.names[k] if k >= 0 else "", toml, settings)
        for k in dict.fromkeys(sorted(rows.group[members].tolist()))
    }
    indices = np.array([[known.position[row], *numbers[rows.group[row]]] for row in members.tolist()])
    values = factor * np.where(known.observed, known.coordinates, np.nan)[members]
    sigmas, times = factor * known.sigmas[members], rows.time[members, None]
    found.groups.append(observation_group(ATTITUDES[axes] if angles else GNSS, indices, values, sigmas, times))


def _navigation_parameters(found: Found, kind: str, name: str, toml: BlockToml, settings: Settings) -> list[int]:
    """Numbers of the nine parameters of one group."""
    section, numbers = section_of(toml, name), []
    owner = Owner("navigation", name) if name else None
    angles = kind == "attitudes"
    factor = RADIANS[settings.units.angle] if angles else 1.0
    for vector in KINDS[kind]:
        unit = (settings.units.angle if angles else settings.units.object) + ("/t" if vector in DRIFTS else "")
        sigma = factor * (section.priors or {}).get(vector, np.nan)
        values = getattr(section, vector) or [0.0] * 3
        for axis, value in zip(axes_of(vector, settings.rotation.system), values, strict=True):
            whole = parameter_name(vector, axis, name)
            parameter = Parameter(whole, unit, vector in section.estimate, angles, owner)
            numbers.append(found.add(parameter, factor * value, sigma))
    return numbers


def axes_of(vector: str, system: str) -> tuple[str, ...]:
    """The components of a systematic error: coordinates or angles."""
    return ROTATION_SYSTEMS[system].angles if vector in OF_ATTITUDES else ("X", "Y", "Z")


def parameter_name(vector: str, axis: str, group: str) -> str:
    """Such as "shift X of strip 1"."""
    return f"{vector} {axis}{f' of {group}' if group else ''}"


def interior_groups(sections: list[CameraSection]) -> list[ObservationGroup]:
    """Interior elements known before, of the cameras in their order; a group for each camera model."""
    groups = []
    for model in dict.fromkeys(section.model for section in sections if section.priors):
        members = [k for k, section in enumerate(sections) if section.model is model and section.priors]
        sigmas = np.array([[(sections[k].priors or {}).get(e, np.nan) for e in model.elements] for k in members])
        values = np.array([[_element(sections[k], e) for e in model.elements] for k in members])
        kind = interior_priors(model.elements)
        groups.append(observation_group(kind, np.array(members)[:, None], values, sigmas))
    return groups


def _element(section: CameraSection, name: str) -> float:
    return interior_values(section).get(name, 0.0)


def interior_values(section: CameraSection) -> dict[str, float]:
    """The interior elements that a section of block.toml gives; all others are 0."""
    x0, y0 = section.principal_point or (0.0, 0.0)
    return {
        "principal_distance": section.principal_distance,
        "x0": x0,
        "y0": y0,
        "pixel_size": 1.0 if section.in_mm else section.pixel_size or 1.0,
        "y_axis": 1.0 if section.in_mm else -1.0,
        **section.coefficients,
        **(section.corrections.coefficients if section.corrections else {}),
    }
