"""Observations that are no rays, and their parameters, as tables of a block folder.

The format has approximate values of lengths and navigation parameters only: orientations of directions, planes and
lines are found from the points when the folder is read.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import ANGLES, LINES, PLANES, geodetic_kind
from jaxbundle.block.observations import PARAMETERS, ObservationGroup, ObservationKind
from jaxbundle.block.problems import Problem
from jaxbundle.block.wording import RADIANS
from jaxbundle.io.observation_groups import FRAME_NAMES, PREFIX
from jaxbundle.io.observation_tables import IMAGE, OWNERS, PAIRS
from jaxbundle.io.tables import Columns

ENDS = ("point", "image")
PAIR_KINDS = {geodetic_kind(name, start, end): name for name in PAIRS for start in ENDS for end in ENDS}
FIGURE_KINDS = {geodetic_kind("plumb_lines"): "plumb_lines", PLANES: "planes", LINES: "lines"}


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


def observation_columns(block: Block) -> dict[str, Columns]:
    """Tables of all geodetic observations, scale bars with their lengths, and figures."""
    tables: dict[str, Columns] = {}
    for name in PAIRS:
        groups = [group for group in block.groups if PAIR_KINDS.get(group.structure.kind) == name]
        if groups:
            tables[name] = _pairs(block, name, groups)
    bars = _bars(block)
    if bars:
        tables["bars"] = bars
    for group in block.groups:
        name = FIGURE_KINDS.get(group.structure.kind)
        if name == "plumb_lines":
            tables[name] = _plumb_lines(block, group)
        elif name:
            tables[name] = _on_figures(block, name, group)
    return tables


def _end_names(block: Block, kind: ObservationKind, indices: Int[np.ndarray, "row touched"], k: int) -> list[str]:
    structure = block.structure
    if kind.touches[k] == "image":
        return [IMAGE + structure.image_names[i] for i in indices[:, k]]
    return [structure.point_names[i] for i in indices[:, k]]


def _pairs(block: Block, name: str, groups: Sequence[ObservationGroup]) -> Columns:
    factor = RADIANS[block.structure.angle_unit] if name in ANGLES else 1.0
    columns: dict[str, list] = {OWNERS[name]: []} if name in OWNERS else {}
    value = PAIRS[name][0]
    columns |= {"from": [], "to": [], **({value: []} if value else {}), "sigma": []}
    owners = owner_names(block, name)
    for group in sorted(groups, key=lambda g: [ENDS.index(t) for t in g.structure.kind.touches[:2]]):
        kind, indices = group.structure.kind, group.structure.indices
        if name in OWNERS:
            columns[OWNERS[name]] += [owners[p] for p in indices[:, 2].tolist()]
        columns["from"] += _end_names(block, kind, indices, 0)
        columns["to"] += _end_names(block, kind, indices, 1)
        if value:
            columns[value] += (np.asarray(group.values)[:, 0] / factor).tolist()
        columns["sigma"] += (np.asarray(group.sigmas)[:, 0] / factor).tolist()
    return {key: np.array(column) if key in (value, "sigma") else column for key, column in columns.items()}


def _owners(block: Block, name: str) -> list[int]:
    """The parameters that belong to the sets or bars of a table, in their order."""
    groups = [group.structure for group in block.groups if PAIR_KINDS.get(group.structure.kind) == name]
    return sorted({int(p) for structure in groups for p in structure.indices[:, 2]})


def owner_names(block: Block, name: str) -> dict[int, str]:
    """Names of sets or bars by their parameter."""
    if name not in PREFIX:
        return {}
    owners = _owners(block, name)
    return dict(zip(owners, _without([block.structure.parameters[p].name for p in owners], PREFIX[name]), strict=True))


def _without(names: list[str], prefix: str) -> list[str]:
    """Names without the prefix that reading adds; as they are where they would not differ any more."""
    bare = [name.removeprefix(prefix) for name in names]
    return bare if len(set(bare)) == len(bare) and "" not in bare else names


def _bars(block: Block) -> Columns | None:
    """Length, and 0 for a length that is held, its sigma where it is observed, NaN where it is unknown."""
    names, priors = owner_names(block, "scale_bars"), priors_of(block)
    if not names:
        return None
    lengths = [priors[p].value if p in priors else float(block.parameters[p]) for p in names]
    free = [block.structure.parameters[p].free for p in names]
    sigmas = [priors[p].sigma if p in priors else np.nan if f else 0.0 for p, f in zip(names, free, strict=True)]
    return {"bar": list(names.values()), "length": np.array(lengths), "sigma": np.array(sigmas)}


def _plumb_lines(block: Block, group: ObservationGroup) -> Columns:
    """Lines are numbered: members that follow each other and start at the same point are one."""
    names, sigmas = block.structure.point_names, np.asarray(group.sigmas)[:, 0].tolist()
    columns: dict[str, list] = {"line": [], "point": [], "sigma": []}
    number, on_line = 0, [-1]
    for (start, end), sigma in zip(group.structure.indices.tolist(), sigmas, strict=True):
        if start != on_line[0] or end in on_line:
            number, on_line = number + 1, [start]
            _append(columns, str(number), names[start], np.nan)
        on_line.append(end)
        _append(columns, str(number), names[end], sigma)
    return {**columns, "sigma": np.array(columns["sigma"])}


def _append(columns: dict[str, list], *cells: object) -> None:
    for column, cell in zip(columns.values(), cells, strict=True):
        column.append(cell)


def figure_names(block: Block, name: str, indices: Int[np.ndarray, "row touched"]) -> list[str]:
    """Names of planes or lines, row by row."""
    first = sorted({int(p) for p in indices[:, 1]})
    prefix = f"{FRAME_NAMES[name][0]} of {name[:-1]} "
    names = dict(zip(first, _without([block.structure.parameters[p].name for p in first], prefix), strict=True))
    return [names[p] for p in indices[:, 1].tolist()]


def _on_figures(block: Block, name: str, group: ObservationGroup) -> Columns:
    indices = group.structure.indices
    return {
        name[:-1]: figure_names(block, name, indices),
        "point": [block.structure.point_names[p] for p in indices[:, 0]],
        "sigma": np.asarray(group.sigmas)[:, 0],
    }


def observation_problems(block: Block) -> list[Problem]:
    """What of these observations has no place in a folder."""
    problems = []
    for group in block.groups:
        kind = group.structure.kind
        name = FIGURE_KINDS.get(kind) or PAIR_KINDS.get(kind) or ""
        if name in FIGURE_KINDS.values() or name == "scale_bars":
            if np.asarray(group.values).any():
                what = f"observed values of {name} are not 0"
                problems.append(Problem(what, "the format knows sigmas of them only; leave them out", name))
        if name in FIGURE_KINDS.values() and np.ptp(np.asarray(group.sigmas), axis=1).any():
            problems.append(Problem(f"components of {name} have several sigmas", "give each member one sigma", name))
        if not group.structure.observed.all() and name:
            problems.append(Problem(f"members of {name} are not observed", "leave them out", name))
    return [*problems, *_problems_of_names(block), *_problems_of_parameters(block)]


def _problems_of_names(block: Block) -> list[Problem]:
    """Sets with several stations, and points whose names look like images."""
    stations: dict[int, set[tuple[str, int]]] = {}
    problems = []
    for group in block.groups:
        kind, indices = group.structure.kind, group.structure.indices
        name = PAIR_KINDS.get(kind)
        if name == "directions":
            for start, _, p in indices.tolist():
                stations.setdefault(p, set()).add((kind.touches[0], start))
        points = {int(p) for k in range(2) if name and kind.touches[k] == "point" for p in indices[:, k]}
        wrong = [block.structure.point_names[p] for p in sorted(points)]
        problems += [
            Problem(f"the name of point {point} begins with '{IMAGE}'", "rename it", name or "")
            for point in wrong
            if point.startswith(IMAGE)
        ]
    return problems + [
        Problem(
            f"parameter {block.structure.parameters[p].name} orients directions from several stations",
            "give each station a parameter of its own",
            "directions",
        )
        for p, places in stations.items()
        if len(places) > 1
    ]


def _problems_of_parameters(block: Block) -> list[Problem]:
    """Orientations, planes and lines that are held, observed or shared."""
    priors, parameters = priors_of(block), block.structure.parameters
    problems, owner = [], {}
    for group in block.groups:
        name = FIGURE_KINDS.get(group.structure.kind) or PAIR_KINDS.get(group.structure.kind) or ""
        if name not in ("directions", "planes", "lines"):
            continue
        first = 2 if name == "directions" else 1
        for row in dict.fromkeys(map(tuple, group.structure.indices[:, first:].tolist())):
            for p in row:
                if owner.setdefault(p, (name, row)) != (name, row):
                    what, cure = "belongs to several figures", "give each parameters of its own"
                elif not parameters[p].free or p in priors:
                    what, cure = "is held or observed, which the format does not know", "leave it unknown"
                else:
                    continue
                problems.append(Problem(f"parameter {parameters[p].name} of {name} {what}", cure, name))
    return problems
