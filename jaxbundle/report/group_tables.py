"""Tables of observations other than rays: groups of one kind together, in the user's names and units."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block, Parameter, Structure
from jaxbundle.block.observation_kinds import PARAMETERS, ObservationGroup, ObservationKind
from jaxbundle.block.wording import IMAGE, RADIANS

OTHER_NAMES = {"parameters": "priors", "interior": "interior_priors"}  # names of other tables of the report
TAKEN = ("images", "cameras", "points", "rays", "check_points", "inner_orientation", "fiducials", "down_weighted")


@dataclass(frozen=True)
class GroupTable:
    """The table of one group. `who`: names of the points or images of each member, by column. Values in user's units.

    `normalised`: v / sigma; of correlated components, v times the root of their weight matrix. Redundancy numbers `r`
    and standardised residuals `w`, NaN where none were computed.
    """

    name: str
    who: dict[str, list[str]]
    components: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, "member component"]
    sigmas: Float[np.ndarray, "member component"]
    residuals: Float[np.ndarray, "member component"]
    normalised: Float[np.ndarray, "member component"]
    r: Float[np.ndarray, "member component"]
    w: Float[np.ndarray, "member component"]

    @property
    def title(self) -> str:
        """The name for use in a sentence."""
        return self.name.replace("_", " ")


def table_name(kind: ObservationKind) -> str:
    """The name of the table of a kind in a report."""
    name = OTHER_NAMES.get(kind.table, kind.table)
    return f"{name}_observed" if name in TAKEN else name


def table_names(block: Block) -> list[str]:
    """Names of the tables of a block's groups."""
    return list(_together(block.groups))


def _together(groups: Iterable[ObservationGroup]) -> dict[str, list[int]]:
    """Indices of the groups of each table: groups of one kind, with any kind of ends."""
    tables: dict[str, list[int]] = {}
    components: dict[str, tuple[str, ...]] = {}
    for k, group in enumerate(groups):
        kind = group.structure.kind
        name, own = table_name(kind), ("value",) if kind.name == "interior" else kind.components
        count = 1
        while components.setdefault(name, own) != own:
            count += 1
            name = f"{table_name(kind)}_{count}"
        tables.setdefault(name, []).append(k)
    return tables


def group_tables(block: Block, *numbers_of_groups: tuple[np.ndarray, ...]) -> list[GroupTable]:
    """A table for each kind of observation. Arguments: residuals, normalised residuals, r and w of all groups."""
    tables = []
    for name, numbers in _together(block.groups).items():
        parts = [_part(name, block, block.groups[k], *(x[k] for x in numbers_of_groups)) for k in numbers]
        columns = dict.fromkeys(column for part in parts for column in part.who)
        empty = {column: [[""] * len(part.values) for part in parts] for column in columns}
        who = {
            column: sum((part.who.get(column, blank) for part, blank in zip(parts, blanks, strict=True)), [])
            for column, blanks in empty.items()
        }
        numbers_of = [[getattr(part, field) for part in parts] for field in NUMBERS]
        tables.append(GroupTable(name, who, parts[0].components, parts[0].units, *map(np.concatenate, numbers_of)))
    return tables


NUMBERS = ("values", "sigmas", "residuals", "normalised", "r", "w")


def _part(name: str, block: Block, group: ObservationGroup, residuals: np.ndarray, *others: np.ndarray) -> GroupTable:
    """The table of one group; `others` have no unit."""
    kind, observed = group.structure.kind, group.structure.observed
    factor, units = _units(block.structure, group)
    values, sigmas, v = (
        np.where(observed, array, np.nan) / factor for array in (np.asarray(group.values), sigmas_of(group), residuals)
    )
    who, components = member_names(block.structure, group), kind.components
    if kind.name == "interior":  # cameras have different elements: one row for each element
        rows, elements = np.nonzero(observed)
        who = {key: [column[r] for r in rows] for key, column in who.items()}
        who["element"] = [components[k] for k in elements]
        values, sigmas, v = (x[rows, elements][:, None] for x in (values, sigmas, v))
        others = tuple(x[rows, elements][:, None] for x in others)
        components, units = ("value",), ("",)
    return GroupTable(name, who, components, units, values, sigmas, v, *others)


def sigmas_of(group: ObservationGroup) -> Float[np.ndarray, "member component"]:
    """A-priori standard deviations, from the covariances where given."""
    if group.covariances is None:
        return np.asarray(group.sigmas)
    return np.sqrt(np.diagonal(np.asarray(group.covariances), axis1=1, axis2=2))


def _units(
    structure: Structure, group: ObservationGroup
) -> tuple[Float[np.ndarray, "member #component"], tuple[str, ...]]:
    """Size of the user's units in those of the block, and their names; "" where members differ or it is unknown."""
    kind, angle = group.structure.kind, RADIANS[structure.angle_unit]
    count, components = len(group.structure.indices), len(kind.components)
    if kind.angles:
        return np.full((count, 1), angle), (structure.angle_unit,) * components
    if kind == PARAMETERS:
        is_angle = np.array([structure.parameters[p].angle for p in group.structure.indices[:, 0]], bool)
        return np.where(is_angle, angle, 1.0)[:, None], ("",)
    return np.ones((count, 1)), ("",) * components


def member_names(structure: Structure, group: ObservationGroup) -> dict[str, list[str]]:
    """Names of the points, images, cameras or parameters of each member, by column.

    Columns are "from" and "to" for observations between two points or images, with "image:" before the name of an
    image; otherwise "point", "image" and "camera", numbered if there are several; and "parameter", or "parameters" for
    the owner of several parameters.
    """
    touches, indices = group.structure.kind.touches, group.structure.indices
    between = sum(kind in ("point", "image") for kind in touches) == 2
    cameras = tuple(camera.name for camera in structure.cameras)
    names = {"point": structure.point_names, "image": structure.image_names, "camera": cameras}
    columns: dict[str, list[str]] = {}
    for k, kind in enumerate(touches):
        if kind == "parameter":
            continue
        column = [names[kind][i] for i in indices[:, k].tolist()]
        if between and kind != "camera":
            column = [IMAGE + name for name in column] if kind == "image" else column
            columns["to" if "from" in columns else "from"] = column
        else:
            several = touches.count(kind) > 1
            columns[f"{kind}_{touches[: k + 1].count(kind)}" if several else kind] = column
    owned = [k for k, kind in enumerate(touches) if kind == "parameter"]
    if owned:
        rows = [[structure.parameters[p] for p in row] for row in indices[:, owned].tolist()]
        columns["parameter" if len(owned) == 1 else "parameters"] = [_common(row) for row in rows]
    return columns


def _common(parameters: list[Parameter]) -> str:
    """The name of one parameter, or the common owner of several, such as "strip 1"."""
    first = parameters[0]
    if len(parameters) == 1:
        return first.name
    owners = {parameter.owner for parameter in parameters}
    return first.owner.words if first.owner and len(owners) == 1 else f"{first.name} ..."
