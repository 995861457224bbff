"""Writing observations other than rays, and their parameters, as tables of a block folder.

The format has approximate values only of lengths and navigation parameters. Orientations of directions, planes and
lines are computed from the points when the folder is read.
"""

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import PARAMETERS, ObservationGroup
from jaxbundle.block.problems import Problem
from jaxbundle.block.wording import IMAGE, RADIANS
from jaxbundle.io.block_tables import TABLES, table_of_kind
from jaxbundle.io.schema import Holds, TableSchema, Unit
from jaxbundle.io.tables import Columns


class Prior(NamedTuple):
    """An observed value of a parameter."""

    value: float
    sigma: float


def priors_of(block: Block) -> dict[int, Prior]:
    """The observed parameters by their number."""
    return {
        int(row[0]): Prior(float(value), float(sigma))
        for group in block.groups
        if group.structure.kind == PARAMETERS
        for row, (value,), (sigma,) in zip(group.structure.indices, group.values, group.sigmas, strict=True)
    }


def groups_of(block: Block) -> dict[str, list[ObservationGroup]]:
    """The groups of each table, in the order in which the reader makes them."""
    tables, found = table_of_kind(), defaultdict(list)
    for group in block.groups:
        if group.structure.kind in tables:
            found[tables[group.structure.kind].name].append(group)
    for name, groups in found.items():
        order = TABLES[name].kinds()
        groups.sort(key=lambda group, order=order: order.index(group.structure.kind))
    return {name: found[name] for name in TABLES if name in found}


def observation_columns(block: Block) -> dict[str, Columns]:
    """The tables of all observations that are written by their schemas, and the tables of their owners."""
    tables: dict[str, dict[str, list]] = {}
    for name, groups in groups_of(block).items():
        schema = TABLES[name]
        if schema.from_first:
            tables[name] = _from_first(block, schema, groups[0])
            continue
        names = owner_names(block, name)
        parts = [_rows(block, schema, group, names) for group in groups]
        tables[name] = {key: sum((part[key] for part in parts), []) for key in parts[0]}
        if schema.owner and schema.owner.table:
            tables[schema.owner.table] = _owners(block, TABLES[schema.owner.table], names)
    numbers = {name: TABLES[name].of(Holds.VALUE, Holds.SIGMA) for name in tables}
    return {
        name: {key: np.array(column, float) if key in numbers[name] else column for key, column in columns.items()}
        for name, columns in tables.items()
    }


def _rows(block: Block, schema: TableSchema, group: ObservationGroup, names: dict[int, str]) -> dict[str, list]:
    """The rows of one group; `names` are the names of the owners."""
    kind, indices = group.structure.kind, group.structure.indices
    factor = RADIANS[block.structure.angle_unit] if schema.unit is Unit.ANGLE else 1.0
    columns: dict[str, list] = {column.name: [] for column in schema.columns}
    if names:
        columns[schema.owner_column] = [names[p] for p in indices[:, len(schema.entities)].tolist()]
    for k, column in enumerate(schema.entities):
        if kind.touches[k] == "point":
            columns[column] = [block.structure.point_names[i] for i in indices[:, k]]
        else:
            prefix = IMAGE if schema.column(column).holds is Holds.END else ""
            columns[column] = [prefix + block.structure.image_names[i] for i in indices[:, k]]
    for holds, values in ((Holds.VALUE, group.values), (Holds.SIGMA, group.sigmas)):
        for column, numbers in zip(
            schema.of(holds), np.asarray(values).T, strict=False
        ):  # one sigma may apply to all components
            columns[column] = (numbers / factor).tolist()
    return columns


def owner_names(block: Block, table: str) -> dict[int, str]:
    """Names of the sets, bars or figures of a table by their first parameters, in the order of these parameters."""
    schema = TABLES[table]
    if not schema.owner or schema.from_first:
        return {}
    groups = groups_of(block).get(table, [])
    owners = sorted({int(p) for group in groups for p in group.structure.indices[:, len(schema.entities)]})
    prefix = schema.prefix(schema.owner.parameters[0][0])
    return dict(zip(owners, _without([block.structure.parameters[p].name for p in owners], prefix), strict=True))


def _without(names: list[str], prefix: str) -> list[str]:
    """Names without the prefix that reading adds; unchanged where they would no longer differ."""
    bare = [name.removeprefix(prefix) for name in names]
    return bare if len(set(bare)) == len(bare) and "" not in bare else names


def _owners(block: Block, schema: TableSchema, names: dict[int, str]) -> dict[str, list]:
    """Value, and sigma: 0 for a fixed value, NaN for an unknown one."""
    priors = priors_of(block)
    values = [priors[p].value if p in priors else float(block.parameters[p]) for p in names]
    free = [block.structure.parameters[p].free for p in names]
    sigmas = [priors[p].sigma if p in priors else np.nan if f else 0.0 for p, f in zip(names, free, strict=True)]
    return dict(zip((column.name for column in schema.columns), (list(names.values()), values, sigmas), strict=True))


def _from_first(block: Block, schema: TableSchema, group: ObservationGroup) -> dict[str, list]:
    """Numbers the owners: successive members with the same first point have one owner."""
    names, sigmas = block.structure.point_names, np.asarray(group.sigmas)[:, 0].tolist()
    rows: list[tuple[str, str, float]] = []
    number, seen = 0, [-1]
    for (start, end), sigma in zip(group.structure.indices.tolist(), sigmas, strict=True):
        if start != seen[0] or end in seen:
            number, seen = number + 1, [start]
            rows.append((str(number), names[start], np.nan))
        seen.append(end)
        rows.append((str(number), names[end], sigma))
    columns = zip(*rows, strict=True)
    return {column.name: list(fields) for column, fields in zip(schema.columns, columns, strict=True)}


def observation_problems(block: Block) -> list[Problem]:
    """Problems of observations that a block folder cannot represent."""
    tables, problems = table_of_kind(), []
    for group in block.groups:
        schema = tables.get(group.structure.kind)
        if schema is None:
            continue
        name = schema.name
        if not schema.of(Holds.VALUE) and np.asarray(group.values).any():
            what = f"observed values of {name} are not 0"
            problems.append(Problem(what, "the format has only their sigmas; leave the values out", name))
        if len(schema.of(Holds.SIGMA)) == 1 and np.ptp(np.asarray(group.sigmas), axis=1).any():
            problems.append(Problem(f"components of {name} have several sigmas", "give each member one sigma", name))
        if not group.structure.observed.all():
            problems.append(Problem(f"members of {name} are not observed", "leave them out", name))
    return [*problems, *_problems_of_names(block), *_problems_of_parameters(block)]


def _problems_of_names(block: Block) -> list[Problem]:
    """Problems of owners with several stations, and of points whose names look like images."""
    stations: dict[tuple[str, int], set[tuple[str, int]]] = defaultdict(set)
    problems = []
    for name, groups in groups_of(block).items():
        schema = TABLES[name]
        for group in groups:
            kind, indices = group.structure.kind, group.structure.indices
            if schema.owner and schema.owner.same:
                k = schema.entities.index(schema.owner.same)
                for row in indices.tolist():
                    stations[name, row[len(schema.entities)]].add((kind.touches[k], row[k]))
            ends = [k for k, column in enumerate(schema.entities) if schema.column(column).holds is Holds.END]
            points = {int(p) for k in ends if kind.touches[k] == "point" for p in indices[:, k]}
            wrong = [point for p in sorted(points) if (point := block.structure.point_names[p]).startswith(IMAGE)]
            problems += [Problem(f"the name of point {p} begins with '{IMAGE}'", "rename it", name) for p in wrong]
    parameters = block.structure.parameters
    return problems + [
        Problem(
            f"parameter {parameters[p].name} orients {name} from several stations",
            "give each station its own parameter",
            name,
        )
        for (name, p), places in stations.items()
        if len(places) > 1
    ]


def _problems_of_parameters(block: Block) -> list[Problem]:
    """Problems of orientations, planes and lines that are fixed, observed or shared."""
    priors, parameters = priors_of(block), block.structure.parameters
    problems, owner = [], {}
    for name, groups in groups_of(block).items():
        schema = TABLES[name]
        if not schema.owner or schema.from_first or schema.owner.table:
            continue
        first = len(schema.entities)
        for row in dict.fromkeys(tuple(row) for group in groups for row in group.structure.indices[:, first:].tolist()):
            for p in row:
                if owner.setdefault(p, (name, row)) != (name, row):
                    what, cure = "belongs to several figures", "give each figure its own parameters"
                elif not parameters[p].free or p in priors:
                    what, cure = (
                        "is fixed or observed, which the format does not support",
                        "make it unknown and unobserved",
                    )
                else:
                    continue
                problems.append(Problem(f"parameter {parameters[p].name} of {name} {what}", cure, name))
    return problems
