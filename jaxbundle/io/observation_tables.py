"""Tables of what is observed between points and images, and of points on common figures.

    distances  horizontal_distances  height_differences  azimuths  zenith_angles      from,to,VALUE,sigma
    directions                                                                        set,from,to,direction,sigma
    scale_bars, bars                                              bar,from,to,sigma and bar,length,sigma
    plumb_lines, lines                                                                line,point,sigma
    planes                                                                            plane,point,sigma

`from` and `to` are names of points, or "image:" and the name of an image for its projection centre. Angles and their
sigmas are in the unit of the folder.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int

from jaxbundle.block.geodetic import ANGLES
from jaxbundle.block.problems import shown
from jaxbundle.io.noted import Noted, listed
from jaxbundle.io.ranges import LARGEST_LENGTH, largest_angle
from jaxbundle.io.tables import GIVE, Table, near, positions_of, where

IMAGE = "image:"  # before the name of an image in `from` and `to`
PAIRS = {  # table: the column of the value, what a row is called
    "distances": ("distance", "distance"),
    "horizontal_distances": ("distance", "horizontal distance"),
    "height_differences": ("difference", "height difference"),
    "azimuths": ("azimuth", "azimuth"),
    "zenith_angles": ("angle", "zenith angle"),
    "directions": ("direction", "direction"),
    "scale_bars": ("", "scale bar"),
}
OWNERS = {"directions": "set", "scale_bars": "bar"}  # the column of what the rows of a table have in common
FIGURES = {"plumb_lines": ("line", 2), "planes": ("plane", 3), "lines": ("line", 2)}  # column, fewest points
POSITIVE = {"distances", "horizontal_distances"}
UNKNOWN_POINT = (
    "measure it on an image, give it X, Y and Z in points.csv or control.csv, correct the name or drop the row"
)

Columns = dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]]


def _pair_columns(kind: str) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    value, called = PAIRS[kind]
    owner = (OWNERS[kind],) if kind in OWNERS else ()
    of = f" of {owner[0]} {{{owner[0]}}}" if owner else ""
    return f"{called} {{from}} - {{to}}{of}", (*owner, "from", "to", *([value] if value else []), "sigma"), ()


COLUMNS: Columns = {
    **{kind: _pair_columns(kind) for kind in PAIRS},
    "bars": ("bar {bar}", ("bar", "length", "sigma"), ()),
    "plumb_lines": ("point {point} of plumb line {line}", ("line", "point", "sigma"), ()),
    "planes": ("point {point} of plane {plane}", ("plane", "point", "sigma"), ()),
    "lines": ("point {point} of line {line}", ("line", "point", "sigma"), ()),
}


class Entities(NamedTuple):
    """What the ends of an observation may be."""

    points: Sequence[str]
    images: Sequence[str]
    images_file: str
    half_turn: float  # in the angle unit of the folder


@dataclass(frozen=True)
class PairRows:
    """Observations from a point or image to another; `is_image` tells which of the two an index counts.

    `owners` are the sets or bars in the order of their first row; `values` is 0 for scale bars.
    """

    table: Table
    is_image: Bool[np.ndarray, "row 2"]
    indices: Int[np.ndarray, "row 2"]
    values: Float[np.ndarray, "row 1"]
    sigmas: Float[np.ndarray, "row 1"]
    owner: Int[np.ndarray, " row"]
    owners: tuple[str, ...]

    @property
    def usable(self) -> Bool[np.ndarray, " row"]:
        """Rows whose ends are known."""
        return (self.indices >= 0).all(1) & (self.owner >= 0)


@dataclass(frozen=True)
class FigureRows:
    """Points on figures; a plumb line is observed from its first point to every other."""

    table: Table
    figure: Int[np.ndarray, " row"]
    figures: tuple[str, ...]
    point: Int[np.ndarray, " row"]
    sigmas: Float[np.ndarray, " row"]

    @property
    def usable(self) -> Bool[np.ndarray, " row"]:
        """Rows whose point and figure are known."""
        return (self.point >= 0) & (self.figure >= 0)


@dataclass(frozen=True)
class BarRows:
    """bars.csv; sigma 0 holds the length, NaN leaves it unknown, else it is observed."""

    table: Table
    names: tuple[str, ...]
    lengths: Float[np.ndarray, " bar"]
    sigmas: Float[np.ndarray, " bar"]


def points_named(tables: Mapping[str, Table]) -> Iterable[str]:
    """The points that tables of observations name."""
    for kind in (*PAIRS, *FIGURES):
        for column in ("from", "to") if kind in PAIRS else ("point",):
            if kind in tables:
                yield from (name for name in tables[kind].text[column] if name and not name.startswith(IMAGE))


def pair_rows(kind: str, table: Table, entities: Entities, bars: BarRows | None, bars_file: str) -> PairRows:
    """A table of observations between two ends."""
    ends = [_end(table, column, entities) for column in ("from", "to")]
    alike = where((table.text["from"] == table.text["to"]) & (table.text["from"] != ""))
    table.note(alike, "both ends are the same", "correct one of them or drop the row")
    column, called = PAIRS[kind]
    largest = largest_angle(entities.half_turn) if kind in ANGLES else LARGEST_LENGTH
    values = table.numbers(column, needed=GIVE, largest=largest) if column else np.zeros((len(table.lines), 1))
    if kind in POSITIVE:
        what = f"the {called} is not positive"
        table.note(np.flatnonzero(values[:, 0] <= 0), what, "give a positive one or drop the row")
    if kind == "zenith_angles":
        outside = np.flatnonzero((values[:, 0] <= 0) | (values[:, 0] >= entities.half_turn))
        what = f"the zenith angle is not between 0 and {entities.half_turn:g}"
        table.note(outside, what, "reduce it to the first face, or drop the row")
    sigmas = table.sigmas("sigma", zero="give a positive one", needed=GIVE)
    is_image, indices = (np.stack(part, 1) for part in zip(*ends, strict=True))
    order = np.lexsort((is_image[:, 1], is_image[:, 0]))  # stable: points before images
    owner, owners = np.zeros(len(table.lines), int), ()
    if kind == "scale_bars":
        owners = bars.names if bars else ()
        owner = table.positions("bar", owners, bars_file) if bars else owner - 1
    elif kind == "directions":
        owner, owners = _numbered(table.names("set"), order)
        _one_station_a_set(table, owners)
    return PairRows(table, is_image, indices, values, sigmas, owner, owners)


def _end(table: Table, column: str, entities: Entities) -> tuple[Bool[np.ndarray, " row"], Int[np.ndarray, " row"]]:
    """Which ends are images, and their positions."""
    names = table.names(column)
    is_image = names.str.starts_with(IMAGE)
    images = positions_of(names.str.strip_prefix(IMAGE), entities.images)
    positions = np.where(is_image.to_numpy(), images, positions_of(names, entities.points))
    missing = pl.Series(positions < 0) & (names != "")
    cure = f"add it there, correct the name behind '{IMAGE}' or drop the row"
    lost = where(missing & is_image)
    table.note(lost, lambda row: f"{column} {shown(names[row])} is not in {entities.images_file}", cure)
    _unknown_points(table, where(missing & ~is_image), names, f"{column} ", entities.points)
    return is_image.to_numpy(), positions


def _unknown_points(
    table: Table, rows: Int[np.ndarray, " row"], names: pl.Series, called: str, points: Sequence[str]
) -> None:
    """Notes names of points that are on no image and have no coordinates."""
    match = near(names.gather(rows).unique(maintain_order=True).to_list(), points)
    cure = f"{match} {UNKNOWN_POINT}" if match else UNKNOWN_POINT
    table.note(rows, lambda row: f"{called}{shown(names[row])} is on no image and has no coordinates", cure)


def _numbered(names: pl.Series, order: Int[np.ndarray, " row"]) -> tuple[Int[np.ndarray, " row"], tuple[str, ...]]:
    """The number of each name, and the names in the order of their first row; -1 for a blank one."""
    distinct = names[order].unique(maintain_order=True)
    distinct = tuple(distinct.filter(distinct != ""))
    return positions_of(names, distinct), distinct


def _one_station_a_set(table: Table, sets: Sequence[str]) -> None:
    first: dict[str, tuple[str, int]] = {}
    wrong: list[int] = []
    rows = zip(table.text["set"], table.text["from"], table.lines.tolist(), strict=True)
    for row, (name, station, line) in enumerate(rows):
        stands, _ = first.setdefault(name, (station, line))
        if name in sets and stands != station and "" not in (stands, station):
            wrong.append(row)

    def words(row: int) -> str:
        name = table.text["set"][row]
        return f"set {shown(name)} was observed from {shown(first[name][0])} (line {first[name][1]})"

    table.note(wrong, words, "give it a set of its own")


def bar_rows(table: Table) -> BarRows:
    """The lengths of scale bars."""
    names = table.names("bar")
    table.unique("bar")
    lengths = table.numbers("length", needed=GIVE)[:, 0]
    cure = "give a positive one, approximate where sigma is empty"
    table.note(np.flatnonzero(lengths <= 0), "the length is not positive", cure)
    return BarRows(table, tuple(names), lengths, table.sigmas("sigma")[:, 0])


def figure_rows(kind: str, table: Table, points: Sequence[str], noted: Noted) -> FigureRows:
    """A table of points on plumb lines, planes or lines."""
    column, fewest = FIGURES[kind]
    names, wanted = table.names(column), table.names("point")
    table.unique(column, "point")
    point = positions_of(wanted, points)
    _unknown_points(table, where(pl.Series(point < 0) & (wanted != "")), wanted, "point ", points)
    figure, figures = _numbered(names, np.arange(len(names)))
    sigmas = table.sigmas("sigma", zero="give a positive one")[:, 0]
    named = np.flatnonzero(figure >= 0)
    first = named[np.unique(figure[named], return_index=True)[1]]
    no_sigma = np.flatnonzero(np.isnan(sigmas) & (table.text["sigma"] == "").to_numpy())
    table.note(np.setdiff1d(no_sigma, first) if kind == "plumb_lines" else no_sigma, "sigma is not given", GIVE)
    count = np.bincount(figure[figure >= 0], minlength=len(figures))
    few = np.flatnonzero(count < fewest)
    if len(few):
        called, k = kind.removesuffix("s").replace("_", " "), few[0]
        what = f"{called} {shown(figures[k])} has {count[k]} of the {fewest} points it needs"
        noted.add_rows(table.file, table.lines[first[few]].tolist(), what, "name more of its points or drop it")
    return FigureRows(table, figure, figures, point, sigmas)


def unused(names: Sequence[str], used: Iterable[int], what: str) -> list[str]:
    """A sentence about what is defined and not used."""
    taken = set(used)
    left = [name for k, name in enumerate(names) if k not in taken]
    if not left:
        return []
    be, take = ("is", "takes") if len(left) == 1 else ("are", "take")
    return [f"{what}{'' if len(left) == 1 else 's'} {listed(left)} {be} in no table and {take} no part"]
