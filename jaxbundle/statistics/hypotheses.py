"""Hypotheses about errors of the observations of a block, each with a few columns of errors.

Hypotheses are about one row of a table, as a whole and by component, about a group that disagrees as a whole, and
about mistakes of known size: exchanged names or axes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Subject
from jaxbundle.block.geodetic import ANGLES
from jaxbundle.statistics.error_columns import FIXED, ErrorColumn

ANGLE_TABLES = (*ANGLES, "attitudes")


class Cause(Enum):
    """The cause of an error; the order is that of preference if two causes explain the same."""

    VALUE = "wrong value"
    NAMES = "exchanged names"
    AXES = "exchanged axes"
    SHIFT = "common shift"
    SCALE = "common scale"
    IMAGE = "scale of image coordinates"


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis: common errors of some observations, with unit errors as columns.

    `members`: the affected rows of tables; `columns`: indices of its columns. Units are "" for a pure number. `whole`:
    not a single component of another hypothesis, and not a mistake of known size.
    """

    subjects: tuple[Subject, ...]
    cause: Cause
    columns: tuple[int, ...]
    components: tuple[str, ...]
    units: tuple[str, ...]
    members: frozenset[tuple[int, int]]
    whole: bool = True

    @property
    def key(self) -> tuple:
        """Key that identifies it among other hypotheses of the same block."""
        return self.cause, self.subjects

    @property
    def is_observed(self) -> bool:
        """Whether it is about observations of one row, and not about fixed coordinates or a group."""
        return self.cause is Cause.VALUE and all(table != FIXED for table, _ in self.members)

    @property
    def exact(self) -> bool:
        """Whether its size is 1 if it is true."""
        return self.cause in (Cause.NAMES, Cause.AXES)


@dataclass(frozen=True)
class Hypotheses:
    """All hypotheses of a block.

    `combinations` makes their columns from the `elementary` ones; `observations`: number of single observations and
    rows, which are all tested, at least by w.
    """

    every: tuple[Hypothesis, ...]
    elementary: tuple[ErrorColumn, ...]
    combinations: sp.csc_matrix
    observations: int

    @property
    def tests(self) -> int:
        """Number of tests: all observations and rows, coordinates of fixed points, groups and their components.

        Mistakes of known size are not additional tests; their size is checked.
        """
        return self.observations + sum(not h.exact and not h.is_observed for h in self.every)


def image_points(block: Block) -> Float[np.ndarray, "ray 2"]:
    """Measured image coordinates in the frame of the residuals, y up."""
    s = block.structure
    down = s.rays_downward
    return np.asarray(block.rays.coordinates) * np.stack([np.ones(len(down)), np.where(down, -1.0, 1.0)], 1)


def subject_of(block: Block, table: int, row: int) -> Subject:
    """The names of a row of a table: the image for a navigation table, the ends for a bar."""
    s = block.structure
    if table == 0:
        return Subject("rays", (s.image_names[s.ray_image[row]], s.point_names[s.ray_point[row]]))
    structure = block.groups[table - 1].structure
    names: dict[str, Callable[[int], str]] = {
        "point": lambda k: s.point_names[k],
        "image": lambda k: s.image_names[k],
        "camera": lambda k: s.cameras[k].name,
        "parameter": lambda k: s.parameters[k].name,
    }
    touched = list(zip(structure.kind.touches, structure.indices[row].tolist(), strict=True))
    if structure.kind.touches[0] != "parameter":  # parameters belong to the row only if it observes one
        touched = [(kind, k) for kind, k in touched if kind != "parameter"]
    return Subject(structure.kind.table, tuple(names[kind](k) for kind, k in touched))


def unit_of(block: Block, table: int, row: int) -> str:
    """Unit of the values of a row for the user."""
    s = block.structure
    if table == 0:
        return s.cameras[s.image_camera[s.ray_image[row]]].image_unit
    structure = block.groups[table - 1].structure
    if structure.kind.touches == ("parameter",):
        return s.parameters[structure.indices[row, 0]].unit
    if structure.kind.touches == ("camera",):
        return ""
    return s.angle_unit if structure.kind.name in ANGLE_TABLES else s.object_unit
