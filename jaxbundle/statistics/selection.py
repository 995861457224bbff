"""Selecting the hypotheses that explain the residuals, each tested in the presence of the others.

    T = g^T M^+ g of p columns,    F = T / p / max(s^2, 1),    s^2 = (v^T P v - T) / (M - N - p)

T of the hypothesis h in the presence of the accepted ones a follows from M and g after elimination of a,

    M' = M - M_a M_aa^+ M_a^T,    g' = g - M_a M_aa^+ g_a

so no adjustment is repeated. A large error increases the residuals of its neighbours (swamping) or hides another
one (masking). Therefore after each acceptance all accepted ones are tested again in the presence of the others, and
replaced by a better explanation or dropped. Hypotheses of different p are compared by the probability of their F
(Foerstner 1983, Kok 1984, Lehmann 2012).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import betaln, fdtrc, hyp2f1

from jaxbundle.statistics.error_columns import ErrorTests
from jaxbundle.statistics.hypotheses import Cause, Hypothesis

CONTROLLED = 1e-6  # minimum part of an error in the residuals; a smaller part is affected by rounding
CONTROLLED_AS_GROUP = 0.01  # for a group: a smaller part means that the unknowns absorb the error
# relative scale of all rays of an image: smaller ones are errors of the camera model, not a wrong resolution
MIN_SCALE = 0.02
TINY = 1e-250  # probabilities below are computed as logarithms
EXACT = 0.1  # tolerance of the linear estimate of the size of a mistake of size 1, in addition to SURE s.d.
SURE = 4.0
AS_GOOD = 4.0  # maximum increase of v^T P v of an alternative in units of s^2: a likelihood ratio of exp(2)


class Tested(NamedTuple):
    """Tests of hypotheses in the presence of the accepted ones.

    T, degrees of freedom, logarithm of the probability, and the part of the error in the residuals (minimum redundancy
    number of a combination of the columns).
    """

    statistic: Float[np.ndarray, " hypothesis"]
    degrees: Int[np.ndarray, " hypothesis"]
    log_probability: Float[np.ndarray, " hypothesis"]
    shown: Float[np.ndarray, " hypothesis"]


class Selection:
    """Tests of hypotheses in the presence of others. `tests` has the columns of the hypotheses."""

    def __init__(self, tests: ErrorTests, hypotheses: Sequence[Hypothesis], log_level: float):
        self.tests, self.hypotheses, self.log_level = tests, hypotheses, log_level
        self._by_width: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for width in sorted({len(h.columns) for h in hypotheses}):
            numbers = np.array([k for k, h in enumerate(hypotheses) if len(h.columns) == width])
            self._by_width[width] = numbers, np.array([hypotheses[k].columns for k in numbers])
        self._least = np.array([CONTROLLED if h.cause is Cause.VALUE else CONTROLLED_AS_GROUP for h in hypotheses])
        self._scales = np.array([h.cause is Cause.IMAGE for h in hypotheses], bool)
        self._exact = np.array([h.exact for h in hypotheses], bool)
        self._groups = [k for k, h in enumerate(hypotheses) if h.cause in (Cause.SHIFT, Cause.SCALE, Cause.IMAGE)]
        self._known: dict[frozenset[int], Tested] = {}

    def columns(self, accepted: Sequence[int]) -> Int[np.ndarray, " column"]:
        """Indices of the columns of some hypotheses."""
        return np.array([c for k in accepted for c in self.hypotheses[k].columns], int)

    def inverse(self, columns: Int[np.ndarray, " column"]) -> tuple[Float[np.ndarray, "column column"], int]:
        """The pseudo-inverse M^+ of some columns, and its rank."""
        if not len(columns):
            return np.zeros((0, 0)), 0
        pseudo, ranks, _ = _pseudo_inverses(
            self.tests.matrix[np.ix_(columns, columns)][None], self.tests.lengths[columns][None], CONTROLLED
        )
        return pseudo[0], int(ranks[0])

    def given(self, accepted: Sequence[int]) -> ErrorTests:
        """Values of g, M, v^T P v and redundancy after elimination of the accepted errors."""
        if not accepted:
            return self.tests
        t, columns = self.tests, self.columns(accepted)
        inverse, rank = self.inverse(columns)
        right = inverse @ t.right[columns]
        return t._replace(
            right=t.right - t.matrix[:, columns] @ right,
            matrix=t.matrix - t.matrix[:, columns] @ inverse @ t.matrix[columns],
            vtpv=t.vtpv - float(t.right[columns] @ right),
            redundancy=t.redundancy - rank,
        )

    def tested(self, accepted: Sequence[int]) -> Tested:
        """Tests of all hypotheses in the presence of the accepted ones; each set of these is computed once."""
        key = frozenset(accepted)
        if key not in self._known:
            self._known[key] = self._tested(sorted(key))
        return self._known[key]

    def _tested(self, accepted: Sequence[int]) -> Tested:
        t, count = self.given(accepted), len(self.hypotheses)
        found = Tested(np.zeros(count), np.zeros(count, int), np.zeros(count), np.zeros(count))
        sizes, deviations = np.ones(count), np.zeros(count)
        for numbers, columns in self._by_width.values():
            pseudo, ranks, shown = _pseudo_inverses(
                t.matrix[columns[:, :, None], columns[:, None, :]], self.tests.lengths[columns], self._least[numbers]
            )
            estimated = np.einsum("hij,hj->hi", pseudo, t.right[columns])
            found.statistic[numbers] = np.maximum(np.einsum("hi,hi->h", estimated, t.right[columns]), 0.0)
            found.degrees[numbers], found.shown[numbers] = ranks, shown
            sizes[numbers], deviations[numbers] = -estimated[:, 0], np.sqrt(pseudo[:, 0, 0])
        left = np.maximum(t.vtpv - found.statistic, 0.0) / np.maximum(t.redundancy - found.degrees, 1)
        f = found.statistic / np.maximum(found.degrees, 1) / np.maximum(left, 1.0)
        usable = (found.degrees > 0) & (t.redundancy > found.degrees)
        wrong_size = np.abs(sizes - 1) > EXACT + SURE * deviations * np.sqrt(np.maximum(left, 1.0))
        usable &= ~(self._exact & wrong_size) & ~(self._scales & (np.abs(sizes) < MIN_SCALE))
        log = np.where(usable, log_probability(f, found.degrees, t.redundancy - found.degrees), 0.0)
        return found._replace(log_probability=log)

    def select(self, most: int, start: Sequence[int] = ()) -> list[int]:
        """Indices of the hypotheses that together explain the residuals, the most probable first."""
        accepted, seen = self._settled(list(start)), set()
        while len(accepted) < most and tuple(accepted) not in seen:
            seen.add(tuple(accepted))
            best, log = self._best(accepted)
            if best is None or log > self.log_level:
                break
            accepted = self._settled([*accepted, best])
        order = {k: self.probability_of(k, accepted) for k in accepted}
        return sorted(accepted, key=lambda k: (order[k], k))

    def probability_of(self, number: int, accepted: Sequence[int]) -> float:
        """Logarithm of the probability of an accepted hypothesis in the presence of the others."""
        return float(self.tested([k for k in accepted if k != number]).log_probability[number])

    def alternatives(self, number: int, accepted: Sequence[int]) -> list[int]:
        """Hypotheses about other observations that are equally good explanations."""
        others = [k for k in accepted if k != number]
        tested, after = self.tested(others), self.tested(accepted)
        t = self.given(accepted)
        variance = max(t.vtpv / max(t.redundancy, 1), 1.0)
        near = tested.statistic >= tested.statistic[number] - AS_GOOD * variance
        near &= tested.degrees <= tested.degrees[number]
        near &= (tested.log_probability < self.log_level) & (after.log_probability > self.log_level)
        free = [k for k in np.flatnonzero(near).tolist() if not any(self._overlap(k, a) for a in accepted)]
        chosen: list[int] = []
        for k in sorted(free, key=lambda k: (tested.log_probability[k], k)):
            if not any(self._overlap(k, other) for other in chosen):
                chosen.append(k)
        return chosen

    def _best(self, accepted: list[int]) -> tuple[int | None, float]:
        """The most probable hypothesis in the presence of the accepted ones; the first of equal ones."""
        tested = self.tested(accepted)
        if not len(tested.statistic):
            return None, 0.0
        best = float(tested.log_probability.min())
        number = int(np.argmax(tested.log_probability <= best + 1e-9 * abs(best)))
        return number, float(tested.log_probability[number])

    def _overlap(self, one: int, other: int) -> bool:
        """Whether two hypotheses are about the same rows."""
        return bool(self.hypotheses[one].members & self.hypotheses[other].members)

    def _merged(self, accepted: list[int]) -> list[int]:
        """Replaces two components of one row by the whole row."""
        for one in accepted:
            for other in accepted:
                both = {*self.hypotheses[one].columns, *self.hypotheses[other].columns}
                if one < other and self._overlap(one, other):
                    whole = (k for k, h in enumerate(self.hypotheses) if both <= set(h.columns))
                    if (k := next(whole, None)) is not None:
                        return self._merged([*(a for a in accepted if a not in (one, other)), k])
        return accepted

    def _as_group(self, accepted: list[int]) -> list[int]:
        """Replaces accepted rows by their group and the rows that differ from its common error, if these are fewer.

        An explanation with fewer errors is more probable.
        """
        covered = {
            g: [k for k in accepted if k != g and self.hypotheses[k].members < self.hypotheses[g].members]
            for g in self._groups
        }
        for g in sorted((g for g, rows in covered.items() if len(rows) >= 2), key=lambda g: (-len(covered[g]), g)):
            instead = [*(k for k in accepted if k not in covered[g] and k != g), g]
            for _ in covered[g][1:]:
                log = self.tested(instead).log_probability
                different = [k for k in covered[g] if k not in instead and log[k] <= self.log_level]
                if not different:
                    if self.probability_of(g, instead) <= self.log_level:
                        return instead
                    break
                instead.append(min(different, key=lambda k: log[k]))
        return accepted

    def _settled(self, accepted: list[int]) -> list[int]:
        """Replaces each accepted hypothesis by a better one, or drops it, until nothing changes."""
        accepted = self._as_group(self._merged(accepted))
        for _ in range(len(accepted) + 2):
            before = list(accepted)
            for k in before:
                others = [a for a in accepted if a != k]
                best, log = self._best(others)
                if best is None or log > self.log_level:
                    accepted = others
                elif best != k and log < self.probability_of(k, accepted) - 1e-9 * abs(log):
                    accepted = self._merged([*others, best])
                elif self.probability_of(k, accepted) > self.log_level:
                    accepted = others
            if accepted == before:
                break
        return accepted


def log_probability(f: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Logarithm of the probability that Fisher's F exceeds f, also far below the minimum of float64."""
    one, two, f = np.maximum(one, 1), np.maximum(two, 1), np.maximum(f, 0.0)
    plain = fdtrc(one, two, f)
    log = np.log(np.maximum(plain, TINY))
    far = plain <= TINY
    x, a, b = (two / (two + one * f))[far], two[far] / 2, one[far] / 2
    with np.errstate(divide="ignore"):
        series = hyp2f1(a + b, 1.0, a + 1.0, x)  # I_x(a, b), Abramowitz and Stegun (1964) 26.5.4
        log[far] = a * np.log(x) + b * np.log1p(-x) - np.log(a) - betaln(a, b) + np.log(series)
    return log


def _pseudo_inverses(
    matrices: Float[np.ndarray, "h p p"], lengths: Float[np.ndarray, "h p"], least: float | Float[np.ndarray, " h"]
) -> tuple[Float[np.ndarray, "h p p"], Int[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """M^+ of each matrix, its rank, and the minimum eigenvalue of M relative to C^T C; 0 if not controlled."""
    scale = np.where(lengths > 0, 1 / np.sqrt(np.where(lengths > 0, lengths, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(matrices * scale[:, :, None] * scale[:, None, :])
    good = values > np.asarray(least).reshape(-1, 1)
    inverse = np.einsum("hik,hk,hjk->hij", vectors, np.where(good, 1 / np.where(good, values, 1.0), 0.0), vectors)
    return inverse * scale[:, :, None] * scale[:, None, :], good.sum(1), np.maximum(values[:, 0], 0.0)
