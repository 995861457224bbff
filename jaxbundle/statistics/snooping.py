"""Data snooping (Baarda 1968): the most suspect observation is removed, the block is adjusted again, and so on.

The suspicions come from `suspects`: a control point that is wrong as a whole is removed as a whole, a fixed one gets
unknown coordinates. Groups that disagree as a whole are reported by `suspects`, but not removed.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.changes import without_component, without_ray
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.error_columns import FIXED
from jaxbundle.statistics.hypotheses import Cause
from jaxbundle.statistics.reliability_tables import redundancy_numbers
from jaxbundle.statistics.suspects import LEVEL, find_suspects

SINGLE = (Cause.VALUE, Cause.NAMES, Cause.AXES)


class Removed(NamedTuple):
    """One removed row with its names, its component ("" for all), and sigma0 after the removal.

    From before the removal: the root of its T as `w` (|w| for one component); residual and redundancy number of its
    worst component, NaN if it was fixed.
    """

    table: str
    names: tuple[str, ...]
    component: str
    w: float
    residual: float
    redundancy_number: float
    sigma0: float

    def __str__(self) -> str:
        of = f" of {self.component}" if self.component else ""
        return (
            f"{self.table} {' - '.join(self.names)}{of}: w = {self.w:.1f}, residual {self.residual:.4g};"
            f" without it sigma0 is {self.sigma0:.4g}"
        )


class Snooping(NamedTuple):
    """The adjustment without the removed rows, and these rows in order. `complete`: whether no suspect remains.

    Example:
        >>> jb.snoop(result).adjustment.success
        True
    """

    adjustment: Adjustment
    removed: tuple[Removed, ...]
    complete: bool


def snoop(adjustment: Adjustment, level: float = LEVEL, most: int = 50) -> Snooping:
    """Removes suspect observations one by one, and adjusts again with the options of the adjustment.

    `level`: level of all tests together; `most`: maximum number of removals. A robust adjustment is returned unchanged,
    as its weights make residuals small.

    Raises: ValueError if the adjustment has no redundancy numbers, and for sensors other than photographs.

    Example:
        >>> cleaned = jb.snoop(result)
        >>> cleaned.complete, cleaned.removed
        (True, ())
    """
    require_a(Adjustment, adjustment, "snoop")
    require_photographs(adjustment.block, "snoop")
    redundancy_numbers(adjustment)
    removed: list[Removed] = []
    while len(removed) < most:
        worst = _worst(adjustment, level)
        if worst is None:
            break
        observations, found = worst
        adjustment = adjust(_without(adjustment.block, observations), adjustment.options)
        removed.append(found._replace(sigma0=float(adjustment.sigma0)))
    return Snooping(adjustment, tuple(removed), not find_suspects(adjustment, level).suspicions)


def _worst(adjustment: Adjustment, level: float) -> tuple[tuple[tuple[int, int, int], ...], Removed] | None:
    """Table, row and component of the most suspect observations, and their description; None without suspects."""
    found = find_suspects(adjustment, level)
    for suspicion, observations in zip(found.suspicions, found.observations, strict=True):
        if suspicion.cause not in SINGLE:
            continue
        table, row, _ = observations[0]
        own = [o for o in observations if o[0] != FIXED]
        r, v = redundancy_numbers(adjustment), adjustment.residuals
        residual, number = np.nan, np.nan
        if own:
            k, *place = max(own, key=lambda o: abs(float(adjustment.weighted_residuals[o[0]][o[1], o[2]])))
            residual, number = float(v[k][tuple(place)]), float(r[k][tuple(place)])
        component = suspicion.subjects[0].component if table else ""
        name, w = "ray" if table == 0 else suspicion.subjects[0].table, float(np.sqrt(suspicion.statistic))
        names = suspicion.subjects[0].names
        return observations, Removed(name, names, component, w, residual, number, np.nan)
    return None


def _without(block: Block, observations: tuple[tuple[int, int, int], ...]) -> Block:
    """The block without some observations of one row; fixed coordinates become unknown."""
    for table, row, component in observations:
        if table == FIXED:
            free = block.structure.point_free.copy()
            free[row, component] = True
            block = dataclasses.replace(block, structure=dataclasses.replace(block.structure, point_free=free))
        elif table > 0:
            block = without_component(block, table - 1, row, component)
    s = block.structure
    for image, name in {
        (s.ray_image[row], s.point_names[s.ray_point[row]]) for table, row, _ in observations if not table
    }:
        s = block.structure  # a point with only one remaining ray is removed too, which changes all later indices
        if name in s.point_names:
            rays = (s.ray_image == image) & (s.ray_point == s.point_names.index(name))
            block = without_ray(block, int(np.argmax(rays))) if rays.any() else block
    return block


def describe(block: Block, table: int, row: int, component: int) -> tuple[tuple[str, ...], str, str]:
    """Names of the entities of an observation, its table and its component; a ray is removed as a whole."""
    s = block.structure
    if table == 0:
        return (s.image_names[s.ray_image[row]], s.point_names[s.ray_point[row]]), "ray", ""
    structure = block.groups[table - 1].structure
    names = {
        "point": s.point_names,
        "image": s.image_names,
        "camera": tuple(c.name for c in s.cameras),
        "parameter": tuple(p.name for p in s.parameters),
    }
    touched = tuple(names[kind][i] for kind, i in zip(structure.kind.touches, structure.indices[row], strict=True))
    return touched, structure.kind.table, structure.kind.components[component]
