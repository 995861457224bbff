"""Types of the descriptions of the tables of a block folder, which `block_tables` contains.

The reader, the writer, messages about columns, ranges of numbers and the page about the format use these
descriptions.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.io.ranges import (
    MAX_COVARIANCE,
    MAX_IMAGE_COORDINATE,
    MAX_LENGTH,
    MAX_SIGMA,
    MAX_TIME,
    largest_angle,
)


class Holds(Enum):
    """Content of the fields of a column."""

    TEXT = "text"
    POINT = "object point"
    IMAGE = "image"
    END = "object point, or `image:` and an image"
    OWNER = "common owner of rows"
    VALUE = "number"
    SIGMA = "standard deviation"
    OTHER = "further number"


class Unit(Enum):
    """Unit of a column of numbers, in words, and the maximum number that is read; for angles 100 full turns."""

    OBJECT = "object unit", MAX_LENGTH
    OBJECT_SQUARED = "object unit squared", MAX_COVARIANCE
    ANGLE = "angle unit", math.inf
    RAYS = "unit of the rays", MAX_IMAGE_COORDINATE
    MM = "mm", MAX_IMAGE_COORDINATE
    PX = "px", MAX_IMAGE_COORDINATE
    TIME = "any unit of time", MAX_TIME
    NONE = "", MAX_LENGTH

    def __init__(self, words: str, maximum: float):
        self.words, self.maximum = words, maximum


@dataclass(frozen=True)
class Column:
    """A column; {0}, {1} and {2} in its name are the three angles of the rotation system.

    `empty`, `zero`, `positive`, `first_face`: the cures for an empty field, for a standard deviation of 0, for a number
    that is not positive, and for an angle not between 0 and half a turn; "" where that is allowed. `missing`: the cure
    for a table without this column.
    """

    name: str
    holds: Holds = Holds.VALUE
    unit: Unit = Unit.NONE
    optional: bool = False
    empty: str = ""
    zero: str = ""
    positive: str = ""
    first_face: str = ""
    missing: str = ""

    def maximum(self, half_turn: float) -> float:
        """The maximum number that is read; `half_turn` in the angle unit."""
        if self.holds is Holds.SIGMA:
            return MAX_SIGMA
        return largest_angle(half_turn) if self.unit is Unit.ANGLE else self.unit.maximum

    @property
    def words(self) -> str:
        """The name of the column; angles have their names in omega-phi-kappa."""
        return self.name.format(*OMEGA_PHI_KAPPA.angles)

    @property
    def may_be(self) -> list[str]:
        """What the column may be: absent, empty or 0."""
        number = self.holds in (Holds.VALUE, Holds.SIGMA, Holds.OTHER)
        allowed = {
            "absent": self.optional,
            "empty": number and not self.empty,
            "0": self.holds is Holds.SIGMA and not self.zero,
        }
        return [words for words, may in allowed.items() if may]


@dataclass(frozen=True)
class OwnerSchema:
    """The common owner of rows of a table: the set of directions, the bar or the plane that a row names.

    `parameters`: unknowns of each owner and their units, none if the other rows refer to the first row of the owner.
    `table`: the table with the value of the parameter and its sigma; "" where it is computed from approximate
    coordinates. `same`: a column in which all rows of an owner agree. `min_rows`: minimum number of rows of an owner;
    more than 1 forbids repeated rows.
    """

    parameters: tuple[tuple[str, Unit], ...] = ()
    table: str = ""
    same: str = ""
    min_rows: int = 1


def called(table: str) -> str:
    """Words for a row of a table and for its owner."""
    return table.removesuffix("s").replace("_", " ")


@dataclass(frozen=True)
class TableSchema:
    """A table: its key in [tables], a description of a row with names of columns in braces, and its columns.

    `kind`: returns the kind of observation of a row; its arguments are "point" or "image" for each end; None where the
    rows are not observations. `plain`: read and written by the columns only, without further code. `systematic`:
    systematic errors of a group that the rows name, as keys of [navigation.NAME].
    """

    name: str
    subject: str
    columns: tuple[Column, ...]
    meaning: str
    kind: Callable[..., ObservationKind] | None = None
    plain: bool = False
    owner: OwnerSchema | None = None
    systematic: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """The usual name of its file."""
        return f"{self.name}.csv"

    @property
    def row(self) -> str:
        """Words for a row or an owner of rows: "height difference", "plumb line"."""
        return called(self.name)

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the required columns."""
        return tuple(column.name for column in self.columns if not column.optional)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns, the required ones first."""
        return (*self.needed, *(column.name for column in self.columns if column.optional))

    def of(self, *holds: Holds) -> tuple[str, ...]:
        """The columns with one of these contents."""
        return tuple(column.name for column in self.columns if column.holds in holds)

    @property
    def entities(self) -> tuple[str, ...]:
        """Columns of points and images, in the order in which an observation touches them."""
        return self.of(Holds.POINT, Holds.IMAGE, Holds.END)

    @property
    def unit(self) -> Unit:
        """Unit of the values, or of their standard deviations where the table has no values."""
        return next(c.unit for holds in (Holds.VALUE, Holds.SIGMA) for c in self.columns if c.holds is holds)

    @property
    def owner_column(self) -> str:
        """Name of the column of the owner; "" where there is none."""
        return next(iter(self.of(Holds.OWNER)), "")

    @property
    def from_first(self) -> bool:
        """Whether the rows of an owner are observed from its first row."""
        return self.owner is not None and not self.owner.parameters

    def prefix(self, parameter: str) -> str:
        """Prefix of an owner's name in the name of its parameter, such as "orientation of set "."""
        return f"{parameter} of {self.owner_column} "

    def column(self, name: str) -> Column:
        """The column with this name."""
        return next(column for column in self.columns if column.name == name)

    def ends(self) -> list[tuple[str, ...]]:
        """Possible combinations of the ends of a row, in the order of the groups of observations."""
        holds = [self.column(name).holds for name in self.entities]
        ways = {Holds.POINT: ("point",), Holds.IMAGE: ("image",), Holds.END: ("point", "image")}
        return list(itertools.product(*(ways[what] for what in holds)))

    def kinds(self) -> list[ObservationKind]:
        """All kinds of observation of this table."""
        return [self.kind(*ends) for ends in self.ends()] if self.kind else []

    def in_system(self, system: RotationSystem) -> "TableSchema":
        """The table with the names of the three angles of a rotation system."""
        columns = tuple(dataclasses.replace(c, name=c.name.format(*system.angles)) for c in self.columns)
        return dataclasses.replace(self, columns=columns)

    def only(self, needed: Sequence[str]) -> "TableSchema":
        """Returns the table in which only these columns are required."""
        columns = tuple(dataclasses.replace(c, optional=c.name not in needed) for c in self.columns)
        return dataclasses.replace(self, columns=columns)
