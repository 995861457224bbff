"""Data snooping (Baarda 1968): the observation with the largest |w| is removed, the block is adjusted again, and so on.

One observation at a time: a gross error raises the residuals of its neighbours too. What nothing controls is left.
"""

from typing import NamedTuple

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.changes import without_component, without_ray
from jaxbundle.block.given import require_a
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.reliability import UNCONTROLLED, critical_w, level_of_one, reliability

LEVEL = 0.05  # that any good observation at all is suspected


class Removed(NamedTuple):
    """One removed observation in the user's names, its w, residual and redundancy number before, sigma0 after."""

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
    """The adjustment without what was removed, and what was, in order. `complete`: nothing suspect is left."""

    adjustment: Adjustment
    removed: tuple[Removed, ...]
    complete: bool


def snoop(adjustment: Adjustment, level: float = LEVEL, most: int = 50) -> Snooping:
    """Removes suspect observations one by one. `level`: of all tests together; `most`: removals at most.

    Raises: ValueError where the adjustment has no redundancy numbers.
    """
    require_a(Adjustment, adjustment, "snoop")
    removed: list[Removed] = []
    while len(removed) < most:
        worst = _worst(adjustment, level)
        if worst is None:
            return Snooping(adjustment, tuple(removed), True)
        table, row, component, found = worst
        block = adjustment.block
        if table == 0:
            block = without_ray(block, row)
        else:
            block = without_component(block, table - 1, row, component)
        adjustment = adjust(block)
        removed.append(found._replace(sigma0=float(adjustment.sigma0)))
    return Snooping(adjustment, tuple(removed), _worst(adjustment, level) is None)


def _worst(adjustment: Adjustment, level: float) -> tuple[int, int, int, Removed] | None:
    """Table, row, component and description of the largest |w| beyond its limit; None where none is."""
    tables = reliability(adjustment)
    limit = critical_w(level_of_one(level, adjustment.observations))
    best, place = limit, None
    for k, (w, r) in enumerate(zip(tables.w, tables.redundancy_numbers, strict=True)):
        size = np.where(r > UNCONTROLLED, np.abs(w), 0.0)
        if size.size and size.max() > best:
            best, place = float(size.max()), (k, *np.unravel_index(int(np.argmax(size)), size.shape))
    if place is None:
        return None
    k, row, component = (int(x) for x in place)
    names, table, what = describe(adjustment.block, k, row, component)
    w, residual = tables.w[k][row, component], float(adjustment.residuals[k][row, component])
    number = tables.redundancy_numbers[k][row, component]
    return k, row, component, Removed(table, names, what, float(w), residual, float(number), np.nan)


def describe(block: Block, table: int, row: int, component: int) -> tuple[tuple[str, ...], str, str]:
    """Names of what an observation touches, its table and its component; a ray is removed whole."""
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
    return touched, structure.kind.name, structure.kind.components[component]
