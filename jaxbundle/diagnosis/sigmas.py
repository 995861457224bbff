"""Checking whether the given sigmas agree with the residuals: the global test, and the factor of each group.

    sigma0 = sqrt(v^T P v / (M - N))            between the roots of chi-square / (M - N), two-sided
    factor = sqrt(sum v^2 P / sum r)            of a group: the factor for its sigmas

A group differs from the others where the ratio of its factor^2 to that of all other observations is outside the limits
of Fisher's F.

With correct sigmas, sigma0 is between its limits in 95 of 100 adjustments (Kraus 2007, app. 4.2). The factors
are absolute: sigmas multiplied by them agree with the residuals (Foerstner 1979, first step).
"""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.reliability_tables import redundancy_numbers
from jaxbundle.statistics.subsets import default_groups

LEVEL = 0.05
FEW = 3.0  # minimum redundancy of a group for a statement about its sigma
GROUP_LEVEL = 0.01  # level of all groups together, for factors that differ from those of the other observations


class GlobalTest(NamedTuple):
    """The global test: sigma0 and its limits."""

    sigma0: float
    lower: float
    upper: float

    @property
    def passed(self) -> bool:
        """Whether sigma0 agrees with the a-priori sigmas."""
        return self.lower <= self.sigma0 <= self.upper


class GroupFactor(NamedTuple):
    """A group of observations and the factor for its sigmas; `differs`: whether it differs from other groups."""

    name: str
    redundancy: float
    factor: float
    differs: bool


def global_test(sigma0: float, redundancy: int) -> GlobalTest:
    """The test of sigma0 against 1, two-sided at 5 %."""
    lower, upper = np.sqrt(chdtri(redundancy, [1 - LEVEL / 2, LEVEL / 2]) / redundancy)
    return GlobalTest(sigma0, float(lower), float(upper))


def group_factors(adjustment: Adjustment) -> list[GroupFactor]:
    """The factors of the groups of observations with sufficient redundancy.

    Raises: ValueError where the adjustment has no redundancy numbers.
    """
    numbers = redundancy_numbers(adjustment)
    squared = [np.asarray(v) ** 2 for v in adjustment.weighted_residuals]
    total, all_squares = adjustment.redundancy, float(adjustment.vtpv)
    factors, groups = [], default_groups(adjustment.block)
    for group in groups:
        redundancy, squares = (
            float(sum(t[mask].sum() for t, mask in zip(table, group.masks, strict=True)))
            for table in (numbers, squared)
        )
        if redundancy < FEW:
            continue
        differs = False
        if total - redundancy >= FEW and all_squares > squares:
            ratio = squares / redundancy / ((all_squares - squares) / (total - redundancy))
            share = fdtrc(redundancy, total - redundancy, ratio)
            differs = bool(min(share, 1 - share) < GROUP_LEVEL / 2 / len(groups))
        factors.append(GroupFactor(group.name, redundancy, float(np.sqrt(squares / redundancy)), differs))
    return factors


def sigma_findings(adjustment: Adjustment, without_suspects: float | None = None) -> tuple[Finding, ...]:
    """One finding if the sigmas do not agree with the residuals, for the whole block or for groups.

    `without_suspects`: sigma0 without suspect observations, which do not count for sigmas; None without suspects.
    """
    test = global_test(
        float(adjustment.sigma0) if without_suspects is None else without_suspects, adjustment.redundancy
    )
    limits = f"between {test.lower:.3f} and {test.upper:.3f} is expected"
    grouped = adjustment.redundancy_numbers is not None and without_suspects is None
    factors = group_factors(adjustment) if grouped else []
    if any(factor.differs for factor in factors):
        listed = "; ".join(f"{f.name} by {f.factor:.2f}" for f in factors)
        what = f"sigma0 is {test.sigma0:.4g} ({limits}), and the groups of observations disagree about their sigmas"
        cure = f"multiply the sigmas of {listed}, or estimate variance components"
        subjects = tuple(Subject("groups", (f.name,)) for f in factors if f.differs)
        return (Finding(Kind.SIGMAS, what, cure, subjects, test.sigma0),)
    if test.passed:
        return ()
    of = "sigma0" if without_suspects is None else "without the suspect observations sigma0"
    what = f"{of} is {test.sigma0:.4g}, {limits}"
    if test.sigma0 > test.upper:
        reason = "the observations are less accurate than their sigmas, or gross or systematic errors remain"
        cure = f"check the largest w first; otherwise multiply all sigmas by {test.sigma0:.3g}"
    else:
        reason = "the observations are more accurate than their sigmas"
        cure = f"multiply all sigmas by {test.sigma0:.3g}"
    return (Finding(Kind.GLOBAL_TEST, f"{what}: {reason}", cure, size=test.sigma0),)
