"""Finding the suspect observations of an adjustment, the most severe first, with the size of their errors.

The estimated sizes of accepted errors are subtracted from the observations and the block is adjusted again, until the
sizes converge. So a large error with a non-linear effect does not cause false suspicions, and sigma0 without it comes
from an adjustment. All array shapes are constant, so all rounds use the program of the first adjustment.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri, ncfdtrinc

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_unknowns_of
from jaxbundle.block.findings import Subject
from jaxbundle.numerics.host import tree_with
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.attempt import attempt
from jaxbundle.statistics.error_columns import FIXED, MAX_DENSE, ErrorColumn, ErrorTests, error_tests
from jaxbundle.statistics.hypotheses import Cause, Hypotheses, Hypothesis
from jaxbundle.statistics.possible_errors import computed_values, possible_errors
from jaxbundle.statistics.reliability_tables import POWER, critical_w, level_of_one, redundancy_numbers
from jaxbundle.statistics.robust_start import robust_point
from jaxbundle.statistics.selection import CONTROLLED, Selection

LEVEL = 0.05  # probability that any good observation is suspected
MOST = 25  # maximum number of suspicions: with more errors the tests are not conclusive
ROUNDS = 5  # maximum rounds of adjustments, and of Gauss-Newton steps of the sizes, the last one without a change
RAYS_FOR_ONE_ROUND = 200_000  # above this, only one additional adjustment is made
LARGE = 3.0  # sigma0 above which the tests start at robust values of the unknowns
EXPLAINED = 1.5  # sigma0 that remains if the residuals are explained
SAME = 0.05  # maximum change of a converged size, in its standard deviations or relative
SHOWN = 0.01  # part of an error in its residuals below which its size is not reported
NO_ERRORS = 1e-6  # sigma0 of observations without errors: residuals are rounding errors


class Suspicion(NamedTuple):
    """A probable error in the user's names and units.

    `subjects` are wrong together; each of `alternatives` would be an equally good explanation. `error`: observed minus
    true value of each component, NaN if the residuals contain too little of it, with `units`, `deviations` and minimal
    detectable errors. `statistic` is T, `probability` its logarithm to the base 10. `shown`: the part of the error in
    the residuals. `sigma0_without`: sigma0 without this error and those of all more severe suspicions.
    """

    subjects: tuple[Subject, ...]
    cause: Cause
    alternatives: tuple[tuple[Subject, ...], ...]
    components: tuple[str, ...]
    error: Float[np.ndarray, " component"]
    units: tuple[str, ...]
    deviations: Float[np.ndarray, " component"]
    minimal_detectable: Float[np.ndarray, " component"]
    statistic: float
    degrees: int
    probability: float
    shown: float
    sigma0_without: float


class Suspects(NamedTuple):
    """The suspicions, the most severe first, and the result without their errors.

    sigma0 without all their errors; the adjustment without these errors, None without any. `observations`: table, row
    and component of each wrong observation.
    """

    suspicions: tuple[Suspicion, ...]
    sigma0: float
    adjustment: Adjustment | None
    observations: tuple[tuple[tuple[int, int, int], ...], ...]


def testable(adjustment: Adjustment) -> bool:
    """Whether the residuals of an adjustment can be tested."""
    return (
        adjustment.redundancy_numbers is not None
        and adjustment.block.structure.model.photographs
        and adjustment.status is Status.CONVERGED
        and not adjustment.undetermined
        and adjustment.reweighting is None
        and adjustment.redundancy >= 2
        and float(adjustment.sigma0) > NO_ERRORS
    )


def suspects(adjustment: Adjustment, level: float = LEVEL) -> tuple[Suspicion, ...]:
    """Finds the suspect observations, the most severe first. `level`: of all tests together.

    None if no test is possible: without redundancy numbers, not converged, with robust weights, or for sensors
    other than photographs.
    """
    return find_suspects(adjustment, level).suspicions


def find_suspects(adjustment: Adjustment, level: float = LEVEL) -> Suspects:
    """Suspects, with the adjustment without their errors."""
    nobody = Suspects((), float(adjustment.sigma0), None, ())
    if not testable(adjustment):
        return nobody
    given = adjustment.block
    state = _start(adjustment, level)
    rounds = ROUNDS if len(given.structure.ray_image) < RAYS_FOR_ONE_ROUND else 1
    for _ in range(rounds):
        if state.settled:
            break
        again = attempt(with_unknowns_of(with_errors_removed(given, state.elementary()), state.block))
        if again is None or float(again.vtpv) > float(adjustment.vtpv):
            break  # too far for the linear tests, so their first result is used
        if state.foretells(again):
            state = dataclasses.replace(state, adjustment=again)
            break
        state = state.next(again)
    return state.found() if state.accepted else nobody


def _start(adjustment: Adjustment, level: float) -> "_State":
    """The tests at the adjustment or at robust values of the unknowns.

    The robust values are used for large residuals, if they give a simpler explanation.
    """
    given, roots = adjustment.block, _roots(adjustment)
    state = _State.of(given, given, _tables(adjustment), roots, level)
    if float(adjustment.sigma0) < LARGE or given.structure.n_unknowns > MAX_DENSE:
        return state
    robust = robust_point(adjustment)
    if robust is None:
        return state
    return min(state, _State.of(given, robust.block, robust.weighted_residuals, roots, level), key=_State.complexity)


def _tables(adjustment: Adjustment) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(v) for v in adjustment.weighted_residuals)


def _roots(adjustment: Adjustment) -> tuple[np.ndarray, ...]:
    """Roots of the redundancy numbers, infinite for uncontrolled observations."""
    numbers = [np.maximum(r, 0.0) for r in redundancy_numbers(adjustment)]
    return tuple(np.sqrt(np.where(r > CONTROLLED, r, np.inf)) for r in numbers)


@dataclasses.dataclass(frozen=True)
class _State:
    """The tests at one linearisation. `removed`: sizes of the errors subtracted from the observations, by keys."""

    given: Block
    block: Block
    w: tuple[np.ndarray, ...]
    roots: tuple[np.ndarray, ...]
    level: float
    hypotheses: Hypotheses
    selection: Selection
    accepted: list[int]
    removed: dict[tuple, Float[np.ndarray, " _component"]]
    adjustment: Adjustment | None = None

    @classmethod
    def of(
        cls, given: Block, block: Block, residuals: tuple[np.ndarray, ...], roots: tuple[np.ndarray, ...], level: float
    ) -> "_State":
        """The first state, without subtracted errors; the unknowns are those of `block`."""
        w = tuple(np.abs(v) / root for v, root in zip(residuals, roots, strict=True))
        hypotheses = possible_errors(given, w, computed_values(block, residuals))
        tests = error_tests(block, residuals, hypotheses.elementary).combined(hypotheses.combinations)
        selection = Selection(tests, hypotheses.every, _log_level(level, hypotheses))
        return cls(given, block, w, roots, level, hypotheses, selection, selection.select(MOST), {})

    def complexity(self) -> tuple[float, int]:
        """Order of explanations: the unexplained part, if large; then the number of errors."""
        left = self.selection.given(self.accepted)
        sigma0 = float(np.sqrt(max(left.vtpv, 0.0) / max(left.redundancy, 1)))
        return (sigma0 if sigma0 > EXPLAINED else 0.0), self.selection.tests.redundancy - left.redundancy

    def next(self, adjustment: Adjustment) -> "_State":
        """The tests at the adjustment without the accepted errors of this state."""
        tables, removed = _tables(adjustment), self.sizes
        pairs = zip(self.w, tables, self.roots, strict=True)
        w = tuple(np.maximum(before, np.abs(v) / root) for before, v, root in pairs)
        hypotheses = possible_errors(self.given, w, computed_values(adjustment.block, tables))
        known = {h.key: k for k, h in enumerate(hypotheses.every)}
        start = [known[key] for key in removed if key in known]
        tests = error_tests(adjustment.block, tables, hypotheses.elementary).combined(hypotheses.combinations)
        columns = np.array([c for k in start for c in hypotheses.every[k].columns], int)
        sizes = np.concatenate([np.zeros(0), *(removed[hypotheses.every[k].key] for k in start)])
        log_level = _log_level(self.level, hypotheses)
        selection = Selection(_put_back(tests, columns, sizes), hypotheses.every, log_level)
        return dataclasses.replace(
            self,
            block=adjustment.block,
            w=w,
            hypotheses=hypotheses,
            selection=selection,
            accepted=selection.select(MOST, start),
            removed=removed,
            adjustment=adjustment,
        )

    @property
    def sizes(self) -> dict[tuple, Float[np.ndarray, " _component"]]:
        """Estimated sizes of the accepted errors, 1 for a known size; by the keys of their hypotheses."""
        estimated, _ = self.estimated
        return {self._of_number(k).key: size for k, size in zip(self.accepted, estimated, strict=True)}

    @property
    def estimated(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Estimated sizes and their standard deviations for sigma0 = 1."""
        if not self.accepted:
            return [], []
        columns = self.selection.columns(self.accepted)
        inverse, _ = self.selection.inverse(columns)
        sizes, deviations = -inverse @ self.selection.tests.right[columns], np.sqrt(np.diagonal(inverse))
        ends = np.cumsum([len(self._of_number(k).columns) for k in self.accepted])[:-1]
        parts, sds = np.split(sizes, ends), np.split(deviations, ends)
        exact = [self._of_number(k).exact for k in self.accepted]
        return [np.ones(1) if e else p for p, e in zip(parts, exact, strict=True)], sds

    @property
    def settled(self) -> bool:
        """Whether the subtracted errors are the accepted ones, with converged sizes."""
        new = self.sizes
        if set(new) != set(self.removed):
            return False
        _, deviations = self.estimated
        for (key, size), sd in zip(new.items(), deviations, strict=True):
            if (np.abs(size - self.removed[key]) > np.maximum(SAME * sd, SAME * SAME * np.abs(size))).any():
                return False
        return True

    def foretells(self, again: Adjustment) -> bool:
        """Whether the adjustment without the accepted errors agrees with the linear tests and has no new suspect."""
        left = self.selection.given(self.accepted)
        variance = max(left.vtpv / max(left.redundancy, 1), 1.0)
        if abs(float(again.vtpv) - left.vtpv) > SAME * variance:
            return False
        limit = critical_w(float(np.exp(self.selection.log_level))) * np.sqrt(variance)
        tested = frozenset[tuple[int, int]]().union(*(h.members for h in self.hypotheses.every))
        large = (
            (table, row)
            for table, (v, root) in enumerate(zip(_tables(again), self.roots, strict=True))
            for row in np.flatnonzero((np.abs(v) > limit * root).any(1)).tolist()
        )
        return all(member in tested for member in large)

    def _of_number(self, number: int) -> Hypothesis:
        return self.hypotheses.every[number]

    def elementary(self) -> list[tuple[ErrorColumn, float]]:
        """The accepted errors in terms of the observations."""
        if not self.accepted:
            return []
        sizes = self.hypotheses.combinations[:, self.selection.columns(self.accepted)] @ np.concatenate(
            self.estimated[0]
        )
        return [(column, float(s)) for column, s in zip(self.hypotheses.elementary, sizes, strict=True) if s]

    def found(self) -> Suspects:
        """The suspicions in the user's names and units."""
        left = self.selection.given(self.accepted)
        sigma0 = float(np.sqrt(max(left.vtpv, 0.0) / max(left.redundancy, 1)))
        suspicions = [self._suspicion(i, sigma0) for i in range(len(self.accepted))]
        observations = tuple(tuple(self._observations(k)) for k in self.accepted)
        return Suspects(tuple(suspicions), sigma0, self.adjustment, observations)

    def _observations(self, number: int) -> Iterator[tuple[int, int, int]]:
        """The wrong observations of a hypothesis, in the order of its columns."""
        h = self.hypotheses
        for elementary in np.unique(h.combinations[:, list(h.every[number].columns)].indices):
            column = h.elementary[elementary]
            for row, component in zip(column.member.tolist(), column.component.tolist(), strict=True):
                yield column.table, row, component

    def _suspicion(self, place: int, sigma0: float) -> Suspicion:
        number = self.accepted[place]
        h, others = self._of_number(number), [k for k in self.accepted if k != number]
        tested, without = self.selection.tested(others), self.selection.given(self.accepted[: place + 1])
        sizes, deviations = (part[place] for part in self.estimated)
        factor = max(sigma0, 1.0)
        redundancy = self.selection.given(others).redundancy
        matrix = np.diagonal(self.selection.given(others).matrix)[list(h.columns)]
        root = np.sqrt(_non_centrality(self.selection.log_level, 1, redundancy - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            detectable = factor * root / np.sqrt(np.maximum(matrix, 0.0))
        told = bool(tested.shown[number] >= SHOWN) and not h.exact
        scale = self._user_scale(h)
        alternatives = tuple(self._of_number(k).subjects for k in self.selection.alternatives(number, self.accepted))
        return Suspicion(
            h.subjects,
            h.cause,
            alternatives,
            h.components,
            scale * sizes if told else np.full(len(sizes), np.nan),
            h.units,
            np.abs(scale) * factor * deviations,
            np.abs(scale) * detectable,
            float(tested.statistic[number]),
            int(tested.degrees[number]),
            float(tested.log_probability[number] / np.log(10)),
            float(tested.shown[number]),
            float(np.sqrt(max(without.vtpv, 0.0) / max(without.redundancy, 1))),
        )

    def _user_scale(self, h: Hypothesis) -> np.ndarray:
        """Conversion from the frame of the residuals to that of the user: angle unit, y of pixels down."""
        s = self.given.structure
        table, member = next(iter(h.members))
        down = table == 0 and s.rays_downward[member]
        by_unit = {"deg": 180 / np.pi, "gon": 200 / np.pi}
        return np.array(
            [-1.0 if down and c == "y" else by_unit.get(u, 1.0) for c, u in zip(h.components, h.units, strict=True)]
        )


def _put_back(tests: ErrorTests, columns: np.ndarray, sizes: np.ndarray) -> ErrorTests:
    """The tests as if the subtracted errors were still present, by the current linear model."""
    change = tests.matrix[:, columns] @ sizes
    vtpv = tests.vtpv - 2 * float(sizes @ tests.right[columns]) + float(sizes @ change[columns])
    return tests._replace(right=tests.right - change, vtpv=vtpv)


def _log_level(level: float, hypotheses: Hypotheses) -> float:
    return float(np.log(level_of_one(level, hypotheses.tests)))


def _non_centrality(log_level: float, degrees: int, redundancy: int) -> float:
    """Non-centrality lambda of an error that an F test detects with the usual power."""
    limit = fdtri(degrees, redundancy, -np.expm1(log_level))
    return float(ncfdtrinc(degrees, redundancy, 1 - POWER, limit))


def with_errors_removed(block: Block, errors: Sequence[tuple[ErrorColumn, float]]) -> Block:
    """The block with errors of some sizes subtracted from its observations and fixed coordinates."""
    s = block.structure
    down = s.rays_downward
    rays, points = np.array(block.rays.coordinates), np.array(block.object_points)
    tables = [np.array(group.values) for group in block.groups]
    for column, size in errors:
        change = size * column.values
        if column.table == FIXED:
            np.subtract.at(points, (column.member, column.component), change)
        elif column.table == 0:
            up = np.where(down[column.member] & (column.component == 1), -1.0, 1.0)
            np.subtract.at(rays, (column.member, column.component), up * change)
        else:
            np.subtract.at(tables[column.table - 1], (column.member, column.component), change)
    return tree_with(
        lambda b: (b.rays.coordinates, b.object_points, *(b.groups[k].values for k in range(len(tables)))),
        block,
        (rays, points, *tables),
    )
