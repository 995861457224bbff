"""Reading and writing navigation data: `group` and `time` of stations.csv and attitudes.csv, and [navigation.NAME].

Times count from the mean of their group: shift and drift refer to that epoch.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import STATIONS, ObservationGroup, ObservationKind
from jaxbundle.block.problems import Problem, shown
from jaxbundle.block.wording import RADIANS
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_tables import COORDINATES, TABLES
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.observation_writer import Prior, priors_of
from jaxbundle.io.settings import NavigationSection
from jaxbundle.io.tables import Columns, Table

SYSTEMATIC = {schema.name: schema.systematic for schema in TABLES.values() if schema.systematic}
Numbers = tuple[int, ...]  # number of parameters of a group
CENTRED = 1e-9  # share of the span of the times: a mean below it is 0 up to rounding


@dataclass(frozen=True)
class NavigationRows:
    """The group of each row, -1 where it has none, and its time from the mean of the group; 0 where not given."""

    table: Table
    group: Int[np.ndarray, " row"]
    time: Float[np.ndarray, " row"]


@dataclass(frozen=True)
class Navigation:
    """Rows of both tables, where given; `origin` is the mean time of each group."""

    rows: dict[str, NavigationRows]
    names: tuple[str, ...]
    origin: Float[np.ndarray, " group"]


def navigation(tables: Mapping[str, Table], toml: BlockToml) -> Navigation:
    """Groups and times of stations and attitudes."""
    names = toml.navigation_names
    given = {kind: tables[kind] for kind in SYSTEMATIC if kind in tables}
    group = {kind: _groups(table, names) for kind, table in given.items()}
    times = {kind: table.numbers("time")[:, 0] for kind, table in given.items()}
    origin = np.zeros(len(names))
    for k in range(len(names)):
        together = np.concatenate([np.zeros(0), *(times[kind][group[kind] == k] for kind in given)])
        together = together[np.isfinite(together)]
        if len(together) and abs(together.mean()) > CENTRED * np.ptp(together):
            origin[k] = together.mean()
    rows = {}
    for kind, table in given.items():
        _require_times(kind, table, group[kind], times[kind], toml)
        start = np.where(group[kind] >= 0, np.append(origin, 0.0)[group[kind]], 0.0)
        rows[kind] = NavigationRows(table, group[kind], np.nan_to_num(times[kind] - start))
    return Navigation(rows, names, origin)


def _groups(table: Table, names: tuple[str, ...]) -> Int[np.ndarray, " row"]:
    """The number of each row's group; names that are not in block.toml are noted."""
    wanted = table.column("group").to_list()
    number = {name: k for k, name in enumerate(names)}
    unknown: dict[str, list[int]] = {}
    for row, name in enumerate(wanted):
        if name and name not in number:
            unknown.setdefault(name, []).append(row)
    for name, rows in unknown.items():
        cure = f"add [navigation.{shown(name)}] there, correct the name or leave it empty"
        table.note(rows, f"group {shown(name)} is not in {FILE}", cure)
    return np.array([number.get(name, -1) for name in wanted], int)


def _require_times(
    kind: str, table: Table, group: Int[np.ndarray, " row"], times: Float[np.ndarray, " row"], toml: BlockToml
) -> None:
    """Notes groups with a drift whose times are unknown or all equal."""
    sections = toml.settings.navigation if toml.settings else None
    drift = next(name for name in SYSTEMATIC[kind] if name.endswith("drift"))
    for k, (name, section) in enumerate((sections or {}).items()):
        if drift not in section.estimate and not any(getattr(section, drift) or ()):
            continue
        rows = np.flatnonzero(group == k)
        missing = rows[np.isnan(times[rows]) & (table.column("time").to_numpy()[rows] == "")]
        if len(missing):
            table.note(
                int(missing[0]), f"group {name} has a {drift} and the row has no time", "give the time in a column time"
            )
        elif len(rows) and drift not in (section.priors or {}) and np.ptp(times[rows]) == 0:
            what = f"group {name} has a {drift} to estimate and all its times are equal"
            table.note(int(rows[0]), what, f"give its true times, a prior of the {drift}, or do not estimate it")


def section_of(toml: BlockToml, name: str) -> NavigationSection:
    """The section of a group; a section without systematic errors where it is missing or wrong."""
    sections = toml.settings.navigation if toml.settings else None
    return (sections or {}).get(name) or NavigationSection()


def navigation_kind(kind: str, system: str) -> ObservationKind:
    """The kind of observation of a table that has systematic errors."""
    return GNSS_STATIONS if kind == "stations" else ATTITUDES[system]


def unit_of(kind: str, lengths: str, angles: str) -> tuple[float, str]:
    """Size and name of the unit of a table: the object unit or the angle unit."""
    return (RADIANS[angles], angles) if kind == "attitudes" else (1.0, lengths)


def axes_of(kind: str, system: str) -> tuple[str, ...]:
    """The components of the systematic errors of a table: coordinates or angles."""
    return ROTATION_SYSTEMS[system].angles if kind == "attitudes" else COORDINATES


def parameter_name(vector: str, axis: str, group: str) -> str:
    """Name of a parameter, such as "shift X of strip 1"."""
    return f"{vector} {axis}{f' of {group}' if group else ''}"


def _group(block: Block, kind: str) -> ObservationGroup | None:
    wanted = navigation_kind(kind, block.structure.rotation_system.name)
    return next((group for group in block.groups if group.structure.kind == wanted), None)


def navigation_columns(block: Block) -> dict[str, Columns]:
    """The tables stations.csv and attitudes.csv; rows without group first."""
    tables: dict[str, Columns] = {}
    plain = next((group for group in block.groups if group.structure.kind == STATIONS), None)
    grouped, attitudes = _group(block, "stations"), _group(block, "attitudes")
    if plain or grouped:
        parts = [_rows(block, group, "stations") for group in (plain, grouped) if group]
        tables["stations"] = {key: _together([part[key] for part in parts]) for key in parts[0]}
        if not grouped:
            del tables["stations"]["group"], tables["stations"]["time"]
    if attitudes:
        tables["attitudes"] = _rows(block, attitudes, "attitudes")
    return tables


def _together(parts: list[Any]) -> Any:
    return sum(parts, []) if isinstance(parts[0], list) else np.concatenate(parts)


def _rows(block: Block, group: ObservationGroup, kind: str) -> Columns:
    """Rows of a table; without group and time where the kind has no parameters."""
    structure, columns = group.structure, axes_of(kind, block.structure.rotation_system.name)
    factor, _ = unit_of(kind, block.structure.object_unit, block.structure.angle_unit)
    values, sigmas = (np.where(structure.observed, x, np.nan) / factor for x in (group.values, group.sigmas))
    plain, names = structure.kind == STATIONS, group_names(block, kind)
    return {
        "image": [block.structure.image_names[i] for i in structure.indices[:, 0]],
        **dict(zip(columns, values.T, strict=True)),
        **{f"s{column}": sigma for column, sigma in zip(columns, sigmas.T, strict=True)},
        "group": ["" if plain else names[tuple(row)] for row in structure.indices[:, 1:].tolist()],
        "time": np.full(len(values), np.nan) if plain else np.asarray(group.constants)[:, 0],
    }


def group_names(block: Block, kind: str) -> dict[Numbers, str]:
    """Names of the groups of a table by their parameters; "" for attitudes without systematic errors."""
    group = _group(block, kind)
    if group is None:
        return {}
    found = list(dict.fromkeys(map(tuple, group.structure.indices[:, 1:].tolist())))
    names = {numbers: _name(block, kind, numbers) for numbers in sorted(found)}
    unnamed = [numbers for numbers, name in names.items() if name is None]
    return {
        numbers: f"{kind} {unnamed.index(numbers) + 1}" if name is None else name for numbers, name in names.items()
    }


def _name(block: Block, kind: str, numbers: Numbers) -> str | None:
    """The name of a group from the names of its parameters; None where these have another form."""
    parameters = [block.structure.parameters[p] for p in numbers]
    name = parameters[0].name.partition(" of ")[2]
    system = block.structure.rotation_system.name
    usual = [parameter_name(vector, axis, name) for vector in SYSTEMATIC[kind] for axis in axes_of(kind, system)]
    if [parameter.name for parameter in parameters] != usual:
        return None
    without_errors = not any(p.free or float(block.parameters[n]) for n, p in zip(numbers, parameters, strict=True))
    return name if name or (kind == "attitudes" and without_errors) else None


def navigation_sections(block: Block) -> dict[str, dict[str, Any]]:
    """The section [navigation.NAME] of each group, in the order of the parameters."""
    priors, sections = priors_of(block), {}
    named = [(numbers, name, kind) for kind in SYSTEMATIC for numbers, name in group_names(block, kind).items() if name]
    for numbers, name, kind in sorted(named):
        factor, _ = unit_of(kind, block.structure.object_unit, block.structure.angle_unit)
        section = sections.setdefault(name, {"estimate": [], "priors": {}})
        for vector, three in _vectors(kind, numbers):
            known = [priors.get(p, Prior(float(block.parameters[p]), np.nan)) for p in three]
            if any(prior.value for prior in known):
                section[vector] = [prior.value / factor for prior in known]
            if block.structure.parameters[three[0]].free:
                section["estimate"].append(vector)
            if known[0].sigma > 0:
                section["priors"][vector] = known[0].sigma / factor
    return {name: {**section, "priors": section["priors"] or None} for name, section in sections.items()}


def _vectors(kind: str, numbers: Numbers) -> list[tuple[str, Numbers]]:
    return [(vector, numbers[3 * k : 3 * k + 3]) for k, vector in enumerate(SYSTEMATIC[kind])]


def navigation_problems(block: Block) -> list[Problem]:
    """Problems of systematic errors that are partly unknown, or shared by groups."""
    priors, parameters = priors_of(block), block.structure.parameters
    problems, owner = [], {}
    for kind in SYSTEMATIC:
        for numbers in group_names(block, kind):
            for vector, three in _vectors(kind, numbers):
                free, sigmas = {parameters[p].free for p in three}, {p: priors[p].sigma for p in three if p in priors}
                first = parameters[three[0]].name
                if any(owner.setdefault(p, (kind, numbers)) != (kind, numbers) for p in three):
                    cure = "give each group its own parameters"
                    problems.append(Problem(f"parameter {first} belongs to several groups", cure, kind))
                elif len(free) > 1 or len(sigmas) not in (0, 3) or len(set(sigmas.values())) > 1:
                    what = f"the three components of {vector}, such as {first}, are not all unknown with one sigma"
                    problems.append(
                        Problem(what, "the format supports only equal settings for the three components", kind)
                    )
                elif sigmas and not all(free):
                    problems.append(Problem(f"parameter {first} is both observed and fixed", "make it unknown", kind))
    return problems
