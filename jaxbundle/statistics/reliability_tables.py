"""Reliability of the observations (Baarda 1968), and tests of their residuals.

    r          redundancy number: the part of an error that appears in its residual
    w = v / (sigma sqrt(r))                         standard normal without gross errors; sigma0 = 1
    tau = w / sigma0_hat                            if only the ratio of the sigmas is known (Pope 1976)
    MDE = sigma delta0 / sqrt(r)                    minimum error that is detected with the given power
    delta0 = z(1 - alpha/2) + z(power)
    external reliability  delta0 sqrt((1 - r) / r)  maximum effect of an undetected error of the size of the MDE on
                                                    any function of the unknowns, in standard deviations

alpha is the level of one test; `level_of_one` computes it for many tests (Sidak 1967). Tables are like the residuals
of an adjustment: the rays first, then each group.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from jaxbundle.block.given import require_a
from jaxbundle.numerics.host import on_host
from jaxbundle.solve.adjustment import Adjustment

LEVEL = 0.001  # level of one test, and
POWER = 0.80  # its power: Baarda's usual choice
UNCONTROLLED = 0.04  # redundancy number below which the unknowns absorb an error (Foerstner 1987: 0.01-0.1)

Tables = tuple[Float[np.ndarray, "_member _component"], ...]


class Reliability(NamedTuple):
    """Reliability tables for rays and groups; NaN where not observed, infinite for uncontrolled observations.

    Example:
        >>> jb.statistics.reliability(result).redundancy_numbers[0].shape
        (32, 2)
    """

    redundancy_numbers: Tables
    w: Tables
    minimal_detectable: Tables
    external: Tables
    level: float
    power: float


def level_of_one(level: float, tests: int) -> float:
    """Level of each of many independent tests, so that one or more fails with probability `level` (Sidak 1967)."""
    return float(-np.expm1(np.log1p(-level) / tests))


def non_centrality(level: float = LEVEL, power: float = POWER) -> float:
    """The non-centrality parameter delta0."""
    return float(ndtri(1 - level / 2) + ndtri(power))


def critical_w(level: float = LEVEL) -> float:
    """Limit of |w| at the level of one test."""
    return float(ndtri(1 - level / 2))


def critical_tau(redundancy: int, level: float = LEVEL) -> float:
    """Limit of |tau| at the level of one test, from Student's t with one degree of freedom less (Pope 1976).

    Raises: ValueError for a redundancy below 2.
    """
    if redundancy < 2:
        raise ValueError(f"the tau test needs a redundancy of at least 2; the redundancy is {redundancy}")
    t = stdtrit(redundancy - 1, 1 - level / 2)
    return float(t * np.sqrt(redundancy) / np.sqrt(redundancy - 1 + t**2))


def redundancy_numbers(adjustment: Adjustment) -> Tables:
    """Redundancy numbers r of all observations, 0 where not observed; their sum is the redundancy.

    Raises: ValueError if the adjustment has none.
    """
    if adjustment.redundancy_numbers is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    return tuple(np.asarray(r) for r in adjustment.redundancy_numbers)


def reliability(adjustment: Adjustment, level: float = LEVEL, power: float = POWER) -> Reliability:
    """Computes the reliability of all observations; for a robust adjustment with the weights of its last round.

    Raises: ValueError if the adjustment has no redundancy numbers.

    Example:
        >>> tables = jb.statistics.reliability(result)
        >>> round(float(tables.redundancy_numbers[0].min()), 3)
        0.113
    """
    require_a(Adjustment, adjustment, "statistics.reliability")
    numbers = redundancy_numbers(adjustment)
    groups = adjustment.block.groups
    observed = [np.ones(adjustment.residuals[0].shape, bool), *(group.structure.observed for group in groups)]
    sigmas = [np.asarray(adjustment.weighted_block.rays.sigmas), *(_sigmas(group) for group in groups)]
    delta = non_centrality(level, power)
    tables = []
    for r, v, is_observed, sigma in zip(numbers, adjustment.weighted_residuals, observed, sigmas, strict=True):
        r = np.where(is_observed, np.clip(r, 0.0, 1.0), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            controlled = (
                r > np.finfo(float).eps ** 0.5
            )  # below this, residual and redundancy number are rounding errors
            w = np.where(controlled, on_host(v) / np.sqrt(r), np.where(is_observed, 0.0, np.nan))
            mde = np.where(controlled, sigma * delta / np.sqrt(r), np.where(is_observed, np.inf, np.nan))
            external = np.where(controlled, delta * np.sqrt((1 - r) / r), np.where(is_observed, np.inf, np.nan))
        tables.append((r, w, mde, external))
    r, w, mde, external = (tuple(column) for column in zip(*tables, strict=True))
    return Reliability(r, w, mde, external, level, power)


def _sigmas(group) -> Float[np.ndarray, "member component"]:
    if group.covariances is None:
        return np.asarray(group.sigmas)
    return np.sqrt(np.diagonal(np.asarray(group.covariances), axis1=1, axis2=2))
