"""Reading tables of observations between points and images, and of points on common figures, by their schemas.

`from` and `to` are names of points, or "image:" and the name of an image for its projection centre. Angles and their
sigmas are in the unit of the folder.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.block.wording import IMAGE
from jaxbundle.io.block_tables import TABLES
from jaxbundle.io.noted import listed
from jaxbundle.io.schema import Holds, OwnerSchema
from jaxbundle.io.tables import Table, near, positions_of, where

UNKNOWN_POINT = (
    "measure it on an image, give it X, Y and Z in points.csv or control.csv, correct the name or drop the row"
)


@dataclass(frozen=True)
class OwnerRows:
    """A table with one value for each owner, such as the lengths of scale bars.

    Sigma 0 fixes the value, NaN makes it unknown, otherwise it is observed.
    """

    table: Table
    names: tuple[str, ...]
    values: Float[np.ndarray, " owner"]
    sigmas: Float[np.ndarray, " owner"]


class Entities(NamedTuple):
    """Names that the rows of a table may use; `owners`: names that another table defines, by this table."""

    points: Sequence[str]
    images: Sequence[str]
    images_file: str
    owners: Mapping[str, OwnerRows]


@dataclass(frozen=True)
class ObservedRows:
    """Rows of one table; `is_image`: whether an index is that of an image or of a point.

    `owners` are the sets, bars or figures in the order of their first row. `values` are 0 where the table has no
    values.
    """

    table: Table
    is_image: Bool[np.ndarray, "row entity"]
    indices: Int[np.ndarray, "row entity"]
    values: Float[np.ndarray, "row component"]
    sigmas: Float[np.ndarray, "row component"]
    owner: Int[np.ndarray, " row"]
    owners: tuple[str, ...]

    @property
    def usable(self) -> Bool[np.ndarray, " row"]:
        """Mask of rows whose points, images and owner are known and whose values are numbers."""
        return (self.indices >= 0).all(1) & (self.owner >= 0) & np.isfinite(self.values).all(1)


def points_named(tables: Mapping[str, Table]) -> Iterable[str]:
    """Names of the points in tables of observations."""
    for schema in TABLES.values():
        for column in schema.of(Holds.POINT, Holds.END) if schema.plain and schema.name in tables else ():
            yield from (name for name in tables[schema.name].text[column] if name and not name.startswith(IMAGE))


def observed_rows(table: Table, entities: Entities) -> ObservedRows:
    """Reads a table of observations."""
    schema = table.schema
    named = [_entity(table, column, entities) for column in schema.entities]
    is_image, indices = (np.stack(part, 1) for part in zip(*named, strict=True))
    ends = schema.of(Holds.END)
    if len(ends) == 2:
        alike = where((table.text[ends[0]] == table.text[ends[1]]) & (table.text[ends[0]] != ""))
        table.note(alike, "both ends are the same", "correct one of them or drop the row")
    columns, components = schema.of(Holds.VALUE), len(schema.kinds()[0].components)
    values = table.numbers(*columns) if columns else np.zeros((len(table.lines), components))
    owner, owners = np.zeros(len(table.lines), int), ()
    if schema.owner:
        order = np.lexsort(is_image.T[::-1])  # stable: rows of points before those of images
        owner, owners = _owners(table, schema.owner, entities, order)
    numbers, first = np.unique(owner, return_index=True)
    sigmas = table.sigmas(*schema.of(Holds.SIGMA), spared=first[(numbers >= 0) & schema.from_first])
    sigmas = np.broadcast_to(sigmas, values.shape) if sigmas.shape[1] == 1 else sigmas
    return ObservedRows(table, is_image, indices, values, sigmas, owner, owners)


def _entity(table: Table, column: str, entities: Entities) -> tuple[Bool[np.ndarray, " row"], Int[np.ndarray, " row"]]:
    """Whether each field of a column names an image, and its index among the images or points."""
    holds, nothing = table.schema.column(column).holds, np.zeros(len(table.lines), bool)
    if holds is Holds.IMAGE:
        return ~nothing, table.positions(column, entities.images, entities.images_file)
    names = table.names(column)
    is_image = names.str.starts_with(IMAGE) if holds is Holds.END else pl.Series(nothing)
    images = positions_of(names.str.strip_prefix(IMAGE), entities.images)
    positions = np.where(is_image.to_numpy(), images, positions_of(names, entities.points))
    missing = pl.Series(positions < 0) & (names != "")
    cure = f"add it there, correct the name behind '{IMAGE}' or drop the row"
    lost = where(missing & is_image)
    table.note(lost, lambda row: f"{column} {shown(names[row])} is not in {entities.images_file}", cure)
    unknown = where(missing & ~is_image)
    match = near(names.gather(unknown).unique(maintain_order=True).to_list(), entities.points)
    cure = f"{match} {UNKNOWN_POINT}" if match else UNKNOWN_POINT
    table.note(unknown, lambda row: f"{column} {shown(names[row])} is on no image and has no coordinates", cure)
    return is_image.to_numpy(), positions


def _owners(
    table: Table, owner: OwnerSchema, entities: Entities, order: Int[np.ndarray, " row"]
) -> tuple[Int[np.ndarray, " row"], tuple[str, ...]]:
    """The number of each row's owner, -1 for an unknown one, and the names of the owners."""
    column = table.schema.owner_column
    if owner.table:
        known = entities.owners.get(owner.table)
        nobody = np.full(len(table.lines), -1)
        return (table.positions(column, known.names, known.table.file), known.names) if known else (nobody, ())
    names = table.names(column)
    distinct = names[order].unique(maintain_order=True)
    owners = tuple(distinct.filter(distinct != ""))
    numbers = positions_of(names, owners)
    if owner.same:
        _require_same(table, owner.same, owners)
    if owner.min_rows > 1:
        table.unique(column, *table.schema.entities)
        _require_rows(table, owner, numbers, owners)
    return numbers, owners


def _require_same(table: Table, same: str, owners: Sequence[str]) -> None:
    """Notes rows whose owner was observed from another station before."""
    column = table.schema.owner_column
    first: dict[str, tuple[str, int]] = {}
    wrong: list[int] = []
    rows = zip(table.text[column], table.text[same], table.lines.tolist(), strict=True)
    for row, (name, station, line) in enumerate(rows):
        stands, _ = first.setdefault(name, (station, line))
        if name in owners and stands != station and "" not in (stands, station):
            wrong.append(row)

    def words(row: int) -> str:
        name = table.text[column][row]
        return f"{column} {shown(name)} was observed from {shown(first[name][0])} (line {first[name][1]})"

    table.note(wrong, words, f"give it its own {column}")


def _require_rows(table: Table, owner: OwnerSchema, numbers: Int[np.ndarray, " row"], owners: tuple[str, ...]) -> None:
    """Notes the first owner with too few rows."""
    count = np.bincount(numbers[numbers >= 0], minlength=len(owners))
    few = np.flatnonzero(count < owner.min_rows)
    if len(few):
        first = [int(table.lines[np.argmax(numbers == k)]) for k in few]
        what = f"{table.schema.row} {shown(owners[few[0]])} has {count[few[0]]} of at least {owner.min_rows} points"
        table.noted.add_rows(table.file, first, what, "name more of its points or drop it")


def owner_rows(table: Table) -> OwnerRows:
    """A table with a value and a standard deviation for each owner."""
    schema = table.schema
    name, *_ = schema.of(Holds.TEXT)
    names = table.names(name)
    table.unique(name)
    values = table.numbers(*schema.of(Holds.VALUE))[:, 0]
    return OwnerRows(table, tuple(names), values, table.sigmas(*schema.of(Holds.SIGMA))[:, 0])


def unused(names: Sequence[str], used: Iterable[int], what: str) -> list[str]:
    """A sentence about names that are defined and not used."""
    taken = set(used)
    left = [name for k, name in enumerate(names) if k not in taken]
    if not left:
        return []
    be = "is" if len(left) == 1 else "are"
    return [f"{what}{'' if len(left) == 1 else 's'} {listed(left)} {be} in no table and {be} not used"]
