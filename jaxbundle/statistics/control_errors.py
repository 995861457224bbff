"""Markuze's criterion of negligible errors of control, compared with the errors of the measurements.

    Q     cofactors of the unknowns, control weighted by its sigmas
    Q0    cofactors if this control were without error
    dQ_i = Q_i - Q0_i <= 0.11 Q0_i for each unknown i: its errors are negligible       (Markuze 1982; Text 001, eq. 7)

0.11 is 1/9: an error a third of another one adds a ninth to its square. For the orientation alone this is, in Text 001,
Q = (A^T W A)^-1, W = (P1^-1 + B P3^-1 B^T)^-1, and Q0 = (A^T P1 A)^-1. Control is made errorless by constraints: with
its rows C of the design matrix,

    Q0 = Q - Q C^T (C Q C^T)^-1 C Q = R^-1 (I - T T^T) R^-T,    T an orthonormal basis of R^-T C^T = (rows of U)^T

computed in the last form, which avoids differences of large squares. An unknown that only this control fixes has no Q0.

The criterion depends on the given weights and not on residuals: control with too small sigmas passes it, even if it
is wrong. Therefore it is combined with a test of the residuals. Without this control, v^T P v decreases by

    T = v_C^T (I - H)^-1 v_C,    v_C the control's residuals over their sigmas, H = C Q C^T

which is chi-square distributed with rank(I - H) degrees of freedom, if all sigmas are correct.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from jaxbundle.block.given import require_a
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.dense import DenseSystem, UnknownTables, dense_system
from jaxbundle.statistics.subsets import (
    Subset,
    all_control,
    control_point,
    observations_of_kind,
    observed_points,
    require_whole_members,
)

NEGLIGIBLE = 0.11  # Text 001, eq. (7)
LEVEL = 0.001  # level of the tests: one in a thousand points without gross error is suspected (Baarda 1968)
FIXED = 1e-14  # Q0 / Q of an unknown that the control fixes: the square of a rounding error
MIN_RANK = 1e-10  # eigenvalues of I - H, and norms of a basis: smaller ones are rounding


class ResidualTest(NamedTuple):
    """The test statistic T and its degrees of freedom; `probability` that chance exceeds it."""

    statistic: float
    degrees: int
    probability: float

    @property
    def passed(self) -> bool:
        """Whether the residuals agree with the sigmas of the control."""
        return self.probability >= LEVEL


class Influence(NamedTuple):
    """The influence of the errors of some control on each unknown; NaN for unknowns that are fixed, or only by it."""

    control: Subset
    errorless: UnknownTables  # Q0
    weighted: UnknownTables  # Q
    ratios: UnknownTables  # dQ / Q0
    largest: float
    most_affected: str  # the unknown with the maximum ratio, "" if there is none
    test: ResidualTest

    @property
    def negligible(self) -> bool:
        """Whether Markuze's criterion is met."""
        return self.largest <= NEGLIGIBLE

    @property
    def may_be_errorless(self) -> bool:
        """Whether the errors are negligible by the given weights, and the residuals do not contradict these."""
        return self.negligible and self.test.passed

    def __str__(self) -> str:
        word = "negligible" if self.negligible else "not negligible"
        where = f" at {self.most_affected}" if self.most_affected else ""
        contradicted = (
            "" if self.test.passed else f"; its residuals contradict its sigmas (p {self.test.probability:.1e})"
        )
        return f"{self.control.name}: {word}, maximum dQ / Q0 {self.largest:.3g}{where}{contradicted}"


class ControlInfluence(NamedTuple):
    """The influence of all control together, of each kind and of each control point.

    `errorless`: control points that may be regarded as without error, all of them together.
    `test`: v^T P v with the redundancy of the whole adjustment.
    """

    together: Influence
    kinds: tuple[Influence, ...]
    points: tuple[Influence, ...]
    errorless: tuple[str, ...]
    test: ResidualTest

    def summary(self) -> str:
        """One line for each influence, and the points that may be regarded as errorless."""
        kinds = self.kinds if len(self.kinds) > 1 else ()  # a single kind is all control
        lines = [str(influence) for influence in (self.together, *kinds, *self.points)]
        if not self.test.passed:
            lines.append(
                f"v^T P v {self.test.statistic:.4g} is too large for a redundancy of {self.test.degrees}: some sigmas"
                " are too small"
            )
        return "\n".join([*lines, f"May be regarded as errorless: {', '.join(self.errorless) or 'none'}"])


def influence(adjustment: Adjustment, control: Subset) -> Influence:
    """The influence of the errors of some control, such as `control_point(block, "12")`.

    Raises: ValueError for image coordinates, for a large block, and for undetermined unknowns.

    Example:
        >>> found = jb.statistics.influence(result, jb.statistics.control_point(block, "A"))
        >>> type(found).__name__
        'Influence'
    """
    require_a(Adjustment, adjustment, "statistics.influence")
    return _influence(dense_system(adjustment), adjustment, control)


def control_influence(adjustment: Adjustment) -> ControlInfluence:
    """The influence of all control, and the points that may be regarded as errorless.

    Control points whose residuals pass their test are added one after the other, the least influential first, as long
    as all of them together meet the criterion. If the global test of the adjustment fails, there are none.

    Raises: ValueError for a block without weighted control, and as `influence`.

    Example:
        >>> found = jb.statistics.control_influence(result)
        >>> found.test.passed
        True
    """
    require_a(Adjustment, adjustment, "statistics.control_influence")
    block = adjustment.block
    kinds = dict.fromkeys(group.structure.kind.name for group in block.groups if group.count)
    if not kinds:
        raise ValueError("the block has no control with sigmas; fixed control has no weight for this criterion")
    system = dense_system(adjustment)

    def of(subset: Subset) -> Influence:
        return _influence(system, adjustment, subset)

    points = tuple(of(control_point(block, name)) for name in observed_points(block))
    test = _probability(float(adjustment.vtpv), adjustment.redundancy)
    return ControlInfluence(
        of(all_control(block)),
        tuple(of(observations_of_kind(block, kind)) for kind in kinds),
        points,
        _errorless_together(system, points) if test.passed else (),
        test,
    )


def _influence(system: DenseSystem, adjustment: Adjustment, control: Subset) -> Influence:
    require_whole_members(adjustment.block, control)
    rows = system.rows(control)
    if control.masks[0].any() or not len(rows):
        raise ValueError(f"{control.name}: control means observations other than image coordinates, and some of it")
    q = np.sum(system.inverse**2, 1)
    basis = _basis(system.orthogonal[rows].T)
    q0 = np.sum((system.inverse - (system.inverse @ basis) @ basis.T) ** 2, 1)
    ratios = _ratios(q, q0)
    largest = -1 if np.isnan(ratios).all() else int(np.nanargmax(ratios))
    return Influence(
        control,
        system.unknown_tables(np.where(np.isnan(ratios), np.nan, q0)),
        system.unknown_tables(q),
        system.unknown_tables(ratios),
        0.0 if largest < 0 else float(ratios[largest]),
        "" if largest < 0 else system.unknown_names[largest],
        _residual_test(system, adjustment, rows),
    )


def _ratios(q: Float[np.ndarray, " free"], q0: Float[np.ndarray, " free"]) -> Float[np.ndarray, " free"]:
    """Ratios dQ / Q0, NaN for unknowns that the control fixes."""
    fixed = q0 <= FIXED * q
    return np.where(fixed, np.nan, (q - q0) / np.where(fixed, 1.0, q0))


def _basis(
    columns: Float[np.ndarray, "free chosen"], before: Float[np.ndarray, "free earlier"] | None = None
) -> Float[np.ndarray, "free constraint"]:
    """Orthonormal basis of the space that some columns add to an earlier basis; empty if they depend on it."""
    lengths = np.linalg.norm(columns, axis=0)
    left = columns[:, lengths > 0] / lengths[lengths > 0]
    if before is not None:
        for _ in range(2):  # a single pass leaves rounding errors
            left = left - before @ (before.T @ left)
    left, size, _ = np.linalg.svd(left, full_matrices=False)
    return left[:, size > MIN_RANK]


def _residual_test(system: DenseSystem, adjustment: Adjustment, rows: Int[np.ndarray, " chosen"]) -> ResidualTest:
    """The test statistic T of some observations."""
    v = np.concatenate([np.asarray(table).ravel() for table in adjustment.weighted_residuals])[rows]
    part = system.orthogonal[rows]
    values, vectors = np.linalg.eigh(np.eye(len(rows)) - part @ part.T)
    tested = values > MIN_RANK
    along = vectors[:, tested].T @ v
    return _probability(float(np.sum(along**2 / values[tested])), int(tested.sum()))


def _probability(statistic: float, degrees: int) -> ResidualTest:
    return ResidualTest(statistic, degrees, float(chi2.sf(statistic, degrees)) if degrees else 1.0)


def _errorless_together(system: DenseSystem, points: Sequence[Influence]) -> tuple[str, ...]:
    """Names of the errorless points. An additional point only increases the ratios: a rejected point stays rejected."""
    q, left = np.sum(system.inverse**2, 1), system.inverse
    taken, basis = [], np.zeros((len(q), 0))
    for point in sorted((p for p in points if p.may_be_errorless), key=lambda point: point.largest):
        new = _basis(system.orthogonal[system.rows(point.control)].T, basis)
        trial = left - (left @ new) @ new.T
        ratios = _ratios(q, np.sum(trial**2, 1))
        if np.isnan(ratios).all() or np.nanmax(ratios) <= NEGLIGIBLE:
            taken.append(point.control.name)
            left, basis = trial, np.concatenate([basis, new], 1)
    return tuple(taken)
