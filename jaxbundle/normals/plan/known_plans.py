"""Cache of plans: a structure is planned once, even if its block is adjusted repeatedly.

A plan depends on a structure, on the indices of its groups, on the devices and on the solver of the reduced equations.
Approximate projection centres only affect the order of the points, so a plan is valid for other values as well.
"""

from typing import NamedTuple
from weakref import WeakKeyDictionary, ref

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Structure
from jaxbundle.block.observation_kinds import GroupStructure, ObservationGroup
from jaxbundle.normals.plan.elimination_plan import EliminationPlan, plan_elimination
from jaxbundle.normals.plan.reduced_plan import MAX_FACTOR, Method

REMEMBERED = 3  # maximum plans of one structure: for statistics on one device, for a solve on several


class _Planned(NamedTuple):
    """A plan and its inputs."""

    groups: "tuple[ref[GroupStructure], ...]"
    devices: int
    solver: Method
    direct: bool
    plan: EliminationPlan

    def serves(self, groups: tuple[ObservationGroup, ...], devices: int, solver: Method, direct: bool) -> bool:
        """Whether the plan would be equal, except for the order of the points."""
        if (self.devices, self.solver) != (devices, solver) or len(self.groups) != len(groups):
            return False
        if any(known() is not group.structure for known, group in zip(self.groups, groups, strict=True)):
            return False
        if solver != "auto" or direct == self.direct:
            return True
        return self.plan.method != "pcg" if direct else _is_small(self.plan)


# a plan does not reference the structure, so that it is deleted with the last block that has it
_PLANS: "WeakKeyDictionary[Structure, list[_Planned]]" = WeakKeyDictionary()


def planned(
    structure: Structure,
    groups: tuple[ObservationGroup, ...],
    centres: Float[np.ndarray, "image 3"] | None,
    devices: int,
    solver: Method = "auto",
    *,
    direct: bool = True,
) -> EliminationPlan:
    """The plan of `plan_elimination`, from the cache if possible."""
    known = _PLANS.setdefault(structure, [])
    for k, entry in enumerate(known):
        if entry.serves(groups, devices, solver, direct):
            known.insert(0, known.pop(k))
            return entry.plan
    plan = plan_elimination(structure, groups, centres, devices, solver, direct=direct)
    known.insert(0, _Planned(tuple(ref(group.structure) for group in groups), devices, solver, direct, plan))
    del known[REMEMBERED:]
    return plan


def _is_small(plan: EliminationPlan) -> bool:
    """Whether the reduced matrix is factorised even if its inverse is not needed, by its number of non-zeros."""
    rows = float(len(plan.order.image) * plan.layout.image)
    return 4 * rows * (rows + plan.layout.image) <= MAX_FACTOR
