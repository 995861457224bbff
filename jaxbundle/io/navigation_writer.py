"""Navigation data as columns of stations.csv and attitudes.csv and as sections [navigation.NAME] of block.toml."""

from typing import Any

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.navigation import ATTITUDES, GNSS
from jaxbundle.block.observations import STATIONS, ObservationGroup
from jaxbundle.block.problems import Problem
from jaxbundle.block.wording import RADIANS
from jaxbundle.io.folder_tables import COORDINATES
from jaxbundle.io.navigation_tables import KINDS
from jaxbundle.io.observation_groups import axes_of, parameter_name
from jaxbundle.io.observation_writer import Prior, priors_of
from jaxbundle.io.tables import Columns

Numbers = tuple[int, ...]  # of the nine parameters of a group


def _group(block: Block, kind: str) -> ObservationGroup | None:
    wanted = GNSS if kind == "stations" else ATTITUDES[block.structure.rotation_system.name]
    return next((group for group in block.groups if group.structure.kind == wanted), None)


def navigation_columns(block: Block) -> dict[str, Columns]:
    """stations.csv and attitudes.csv; those of no group first."""
    tables: dict[str, Columns] = {}
    plain = next((group for group in block.groups if group.structure.kind == STATIONS), None)
    grouped, attitudes = _group(block, "stations"), _group(block, "attitudes")
    if plain or grouped:
        parts = [_rows(block, group, COORDINATES, "stations") for group in (plain, grouped) if group]
        tables["stations"] = {key: _together([part[key] for part in parts]) for key in parts[0]}
        if not grouped:
            del tables["stations"]["group"], tables["stations"]["time"]
    if attitudes:
        tables["attitudes"] = _rows(block, attitudes, block.structure.rotation_system.angles, "attitudes")
    return tables


def _together(parts: list[Any]) -> Any:
    return sum(parts, []) if isinstance(parts[0], list) else np.concatenate(parts)


def _rows(block: Block, group: ObservationGroup, columns: tuple[str, ...], kind: str) -> Columns:
    """Rows of a table; no group and no time where the kind has no parameters."""
    structure = group.structure
    factor = RADIANS[block.structure.angle_unit] if kind == "attitudes" else 1.0
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
    """The name that its parameters were given when they were read; None where they have other names."""
    parameters = [block.structure.parameters[p] for p in numbers]
    name = parameters[0].name.partition(" of ")[2]
    system = block.structure.rotation_system.name
    usual = [parameter_name(vector, axis, name) for vector in KINDS[kind] for axis in axes_of(vector, system)]
    if [parameter.name for parameter in parameters] != usual:
        return None
    without_errors = not any(p.free or float(block.parameters[n]) for n, p in zip(numbers, parameters, strict=True))
    return name if name or (kind == "attitudes" and without_errors) else None


def navigation_sections(block: Block) -> dict[str, dict[str, Any]]:
    """[navigation.NAME] of every group, in the order of their parameters."""
    priors, sections = priors_of(block), {}
    named = [(numbers, name, kind) for kind in KINDS for numbers, name in group_names(block, kind).items() if name]
    for numbers, name, kind in sorted(named):
        factor = RADIANS[block.structure.angle_unit] if kind == "attitudes" else 1.0
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
    return [(vector, numbers[3 * k : 3 * k + 3]) for k, vector in enumerate(KINDS[kind])]


def navigation_problems(block: Block) -> list[Problem]:
    """Systematic errors that are unknown in part, or shared by groups."""
    priors, parameters = priors_of(block), block.structure.parameters
    problems, owner = [], {}
    for kind in KINDS:
        for numbers in group_names(block, kind):
            for vector, three in _vectors(kind, numbers):
                free, sigmas = {parameters[p].free for p in three}, {p: priors[p].sigma for p in three if p in priors}
                first = parameters[three[0]].name
                if any(owner.setdefault(p, (kind, numbers)) != (kind, numbers) for p in three):
                    cure = "give each group parameters of its own"
                    problems.append(Problem(f"parameter {first} belongs to several groups", cure, kind))
                elif len(free) > 1 or len(sigmas) not in (0, 3) or len(set(sigmas.values())) > 1:
                    what = f"the components of {vector}, {first} and its kin, are not all unknown with one sigma"
                    problems.append(Problem(what, "the format knows them together only", kind))
                elif sigmas and not all(free):
                    problems.append(Problem(f"parameter {first} is observed and held", "make it unknown", kind))
    return problems
