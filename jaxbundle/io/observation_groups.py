"""Groups of observations and their parameters from the rows of a block folder's tables.

Values that are not in the tables are NaN and are computed from approximate coordinates
(orientation/planes_and_lines.py): the orientations of sets of directions, planes and lines.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Owner, Parameter
from jaxbundle.block.observation_kinds import (
    CONTROL,
    PARAMETERS,
    STATIONS,
    ObservationGroup,
    ObservationKind,
    interior_priors,
    observation_group,
)
from jaxbundle.block.wording import RADIANS
from jaxbundle.io.block_toml import BlockToml
from jaxbundle.io.folder_tables import FolderTables
from jaxbundle.io.known_tables import KnownRows
from jaxbundle.io.navigation_tables import SYSTEMATIC, axes_of, navigation_kind, parameter_name, section_of, unit_of
from jaxbundle.io.observation_tables import ObservedRows, OwnerRows
from jaxbundle.io.schema import Unit
from jaxbundle.io.settings import CameraSection, Settings


@dataclass
class Found:
    """Groups and parameters found so far; values of angles in radians; `priors`: parameter, value, sigma."""

    groups: list[ObservationGroup] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    priors: list[tuple[int, float, float]] = field(default_factory=list)

    def add(self, parameter: Parameter, value: float, sigma: float = np.nan) -> int:
        """Adds a parameter, observed where it has a sigma, and returns its number."""
        number = len(self.parameters)
        self.parameters.append(parameter)
        self.values.append(value)
        if sigma > 0:
            self.priors.append((number, value, sigma))
        return number


def found_in(tables: FolderTables, toml: BlockToml, settings: Settings) -> Found:
    """All observations of the tables except rays, and their parameters."""
    found = Found()
    if "control" in tables.known and len(tables.known["control"].members):
        found.groups.append(_coordinate_group(CONTROL, tables.known["control"]))
    _plain_stations(found, tables)
    for rows in tables.observed.values():
        owner = rows.table.schema.owner
        _observations(found, rows, tables.owners.get(owner.table) if owner else None, settings)
    for kind in SYSTEMATIC:
        _navigation(found, kind, tables, toml, settings)
    if found.priors:
        numbers, values, sigmas = (np.array(column)[:, None] for column in zip(*found.priors, strict=True))
        found.groups.append(observation_group(PARAMETERS, numbers, values, sigmas))
    return found


def _coordinate_group(kind: ObservationKind, rows: KnownRows, members: np.ndarray | None = None) -> ObservationGroup:
    members = rows.members if members is None else members
    values = np.where(rows.observed, rows.coordinates, np.nan)[members]
    covariances = None if rows.covariances is None else rows.covariances[members]
    return observation_group(kind, rows.position[members, None], values, rows.sigmas[members], None, covariances)


def _plain_stations(found: Found, tables: FolderTables) -> None:
    """Stations without systematic errors, which are the stations without group."""
    if "stations" in tables.known:
        rows = tables.known["stations"]
        members = rows.members[tables.navigation.rows["stations"].group[rows.members] < 0]
        if len(members):
            found.groups.append(_coordinate_group(STATIONS, rows, members))


def _observations(found: Found, rows: ObservedRows, owners: OwnerRows | None, settings: Settings) -> None:
    """The observations of one table: one group for each combination of ends (point or image)."""
    schema, owner = rows.table.schema, rows.table.schema.owner
    assert schema.kind is not None
    factor = RADIANS[settings.units.angle] if schema.unit is Unit.ANGLE else 1.0
    used = np.flatnonzero(rows.usable)
    indices, is_image = rows.indices[used], rows.is_image[used]
    if schema.from_first:
        used, indices = _from_first(rows, used)
        is_image = np.zeros_like(rows.is_image[used])
    elif owner:
        numbers = {
            k: [_parameter(found, rows, k, which, owners, settings) for which in range(len(owner.parameters))]
            for k in dict.fromkeys(sorted(rows.owner[used].tolist()))
        }
        indices = np.c_[
            indices, np.array([numbers[k] for k in rows.owner[used].tolist()], int).reshape(-1, len(owner.parameters))
        ]
    for ends in schema.ends():
        members = np.flatnonzero((is_image == [end == "image" for end in ends]).all(1))
        if len(members):
            kind = schema.kind(*ends)
            values, sigmas = factor * rows.values[used[members]], factor * rows.sigmas[used[members]]
            constants = np.full((len(members), len(kind.constants)), np.nan)
            found.groups.append(observation_group(kind, indices[members], values, sigmas, constants))


def _from_first(rows: ObservedRows, used: np.ndarray) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, "row 2"]]:
    """All rows but the first of each owner, with the points of the first row and their own points."""
    order = used[np.argsort(rows.owner[used], kind="stable")]
    starts = np.diff(rows.owner[order], prepend=-1) != 0
    first = order[np.flatnonzero(starts)[np.cumsum(starts) - 1]] if len(order) else order
    points = rows.indices[:, 0]
    return order[~starts], np.c_[points[first], points[order]][~starts]


def _parameter(
    found: Found, rows: ObservedRows, owner: int, which: int, owners: OwnerRows | None, settings: Settings
) -> int:
    """Adds one parameter of an owner and returns its number; the value is NaN where no table gives it."""
    schema = rows.table.schema
    assert schema.owner is not None
    called, quantity = schema.owner.parameters[which]
    angle = quantity is Unit.ANGLE
    unit = {Unit.ANGLE: settings.units.angle, Unit.OBJECT: settings.units.object}.get(quantity, "")
    value, sigma = (float(owners.values[owner]), float(owners.sigmas[owner])) if owners else (np.nan, np.nan)
    name = schema.prefix(called) + rows.owners[owner]
    whose = Owner(f"{schema.owner_column}s", rows.owners[owner])
    return found.add(Parameter(name, unit, sigma != 0, angle, whose), value, sigma)


def _navigation(found: Found, kind: str, tables: FolderTables, toml: BlockToml, settings: Settings) -> None:
    """Stations of groups, or attitudes: nine parameters for each group; only some of them are unknown."""
    if kind not in tables.known:
        return
    known, rows = tables.known[kind], tables.navigation.rows[kind]
    members = known.members
    members = members if kind == "attitudes" else members[rows.group[members] >= 0]
    if not len(members):
        return
    numbers = {
        k: _navigation_parameters(found, kind, tables.navigation.names[k] if k >= 0 else "", toml, settings)
        for k in dict.fromkeys(sorted(rows.group[members].tolist()))
    }
    factor, _ = unit_of(kind, settings.units.object, settings.units.angle)
    indices = np.array([[known.position[row], *numbers[rows.group[row]]] for row in members.tolist()])
    values = factor * np.where(known.observed, known.coordinates, np.nan)[members]
    sigmas, times = factor * known.sigmas[members], rows.time[members, None]
    observed = navigation_kind(kind, settings.rotation.system)
    found.groups.append(observation_group(observed, indices, values, sigmas, times))


def _navigation_parameters(found: Found, kind: str, name: str, toml: BlockToml, settings: Settings) -> list[int]:
    """Adds the nine parameters of one group and returns their numbers."""
    section, numbers = section_of(toml, name), []
    owner = Owner("navigation", name) if name else None
    factor, unit = unit_of(kind, settings.units.object, settings.units.angle)
    for vector in SYSTEMATIC[kind]:
        sigma = factor * (section.priors or {}).get(vector, np.nan)
        values = getattr(section, vector) or [0.0] * 3
        for axis, value in zip(axes_of(kind, settings.rotation.system), values, strict=True):
            of_time = "/t" if vector.endswith("drift") else ""
            free, angle = vector in section.estimate, kind == "attitudes"
            parameter = Parameter(parameter_name(vector, axis, name), unit + of_time, free, angle, owner)
            numbers.append(found.add(parameter, factor * value, sigma))
    return numbers


def interior_groups(sections: list[CameraSection]) -> list[ObservationGroup]:
    """Observed interior elements of the cameras in their order; one group for each camera model."""
    groups = []
    for model in dict.fromkeys(section.model for section in sections if section.priors):
        members = [k for k, section in enumerate(sections) if section.model is model and section.priors]
        sigmas = np.array([[(sections[k].priors or {}).get(e, np.nan) for e in model.elements] for k in members])
        values = np.array([[interior_values(sections[k]).get(e, 0.0) for e in model.elements] for k in members])
        kind = interior_priors(model.elements)
        groups.append(observation_group(kind, np.array(members)[:, None], values, sigmas))
    return groups


def interior_values(section: CameraSection) -> dict[str, float]:
    """The interior elements that a section of block.toml gives; all other elements are 0."""
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
