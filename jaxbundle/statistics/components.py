"""Variance components: the a-posteriori precision of each group of observations, and so the weights between groups.

    r_i = n_i - tr(N^-1 N_i),    N_i = A_i^T P_i A_i                                  sum r_i = M - N
    q_i = v_i^T P_i v_i
    "redundancy"   s_i = q_i / r_i                                                   (Foerstner 1979)
    "helmert"      S s = q,    S_ij = delta_ij (n_i - 2 tr N^-1 N_i) + tr(N^-1 N_i N^-1 N_j)      (Helmert 1907)

The sigmas of group i are multiplied by sqrt(s_i) and the block is adjusted again, until all s_i are 1. As the rows of S
sum up to r_i, both forms converge to the same solution, q_i = r_i. For normal errors the covariance of q is then 2 S,
so that of the components is 2 S^-1, in units of the components.

The component of group i is the product of its s_i: its variance of unit weight for the a-priori sigmas. Ratios of
components are the coefficients of coordination C_i^2 = mu_1^2 / mu_i^2 of Text 001.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Unpack

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_sigmas_multiplied, with_unknowns_of
from jaxbundle.block.datum import with_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.validate import require_valid
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.options import Choices, Options, chosen
from jaxbundle.statistics import dense
from jaxbundle.statistics.reliability_tables import redundancy_numbers
from jaxbundle.statistics.subsets import Subset, all_observations, default_groups, require_whole_members

Form = Literal["redundancy", "helmert"]
Groups = Float[np.ndarray, " group"]
Free = Bool[np.ndarray, " group"]
# minimum redundancy of a group: with less, the relative standard deviation of its component exceeds 0.8
MIN_REDUNDANCY = 3.0
MAX_STEP = 100.0  # maximum change of a component in one round
MAX_COMPONENT = 1e6  # or its inverse: sigmas that are wrong by a factor of a thousand are not a problem of weights
INSEPARABLE = 1e-10  # minimum eigenvalue of S with a unit diagonal
REST = "not requested"
SMALL = f"redundancy below {MIN_REDUNDANCY:g}"
FALLEN = f"while the component decreased, its redundancy fell below {MIN_REDUNDANCY:g}"
LIMIT = f"above {MAX_COMPONENT:g} or below its inverse"


class HelmertSystem(NamedTuple):
    """The matrix S and the redundancy r of each group, its row sum."""

    matrix: Float[np.ndarray, "group group"]
    redundancy: Groups


@dataclass(frozen=True)
class VarianceComponents:
    """Variance components, one per group, in the requested order; other observations come last.

    `components` multiply the a-priori variances, `factors`, their roots, the sigmas. `deviations` are the standard
    deviations of the components, NaN for a fixed group; `held` has the reason ("" if not fixed). If the block is too
    large for S, they are lower bounds, sqrt(2 / r_i). `adjustment` is the last one, with the final sigmas.

    Example:
        >>> rays = jb.statistics.tie_rays(block), jb.statistics.control_rays(block)
        >>> len(jb.statistics.variance_components(block, rays).names)
        3
    """

    form: Form
    names: tuple[str, ...]
    observations: tuple[int, ...]
    redundancy: Groups
    components: Groups
    deviations: Groups
    deviations_are_bounds: bool
    sigmas: Groups  # a-posteriori roots of the mean variance of an observation
    held: tuple[str, ...]
    negative: tuple[str, ...]  # groups with a negative Helmert component during the iterations
    rounds: int
    converged: bool
    adjustment: Adjustment

    @property
    def factors(self) -> Groups:
        """The factors for the a-priori sigmas."""
        return np.sqrt(self.components)

    @property
    def factor_deviations(self) -> Groups:
        """Standard deviations of the factors."""
        return self.deviations / (2 * self.factors)

    @property
    def coordination(self) -> Groups:
        """C_i^2 = s_1^2 / s_i^2: factors of the a-priori weights 1 / sigma^2, with the factor 1 for the first group."""
        return self.components[0] / self.components

    def summary(self) -> str:
        """The components as a table, with remarks."""
        ended = f"converged after {self.rounds} rounds" if self.converged else "NOT CONVERGED"
        wide = max(map(len, self.names))
        lines = [
            f"Variance components ({self.form}): {ended}",
            f"{'group':{wide}}      n          r    component       s.d.      sigma *      sigma        C^2",
        ]
        for k, name in enumerate(self.names):
            numbers = self.components, self.deviations, self.factors, self.sigmas, self.coordination
            row = "".join(f"{column[k]:11.4g}" for column in numbers)
            held = f"  sigma a priori: {self.held[k]}" if self.held[k] else ""
            lines.append(f"{name:{wide}}{self.observations[k]:7}{self.redundancy[k]:11.2f}  {row}{held}")
        if self.deviations_are_bounds:
            lines.append("The block is too large for the covariances of the components: s.d. are lower bounds")
        lines += [
            f"{name}: the component was negative during the iterations, that of the redundancy form was used"
            for name in self.negative
        ]
        return "\n".join(lines)


def helmert_system(system: dense.DenseSystem, subsets: Sequence[Subset]) -> HelmertSystem:
    """The matrix S from the orthogonal factor U of A: tr(N^-1 N_i N^-1 N_j) = tr(G_i G_j), G_i = U_i^T U_i."""
    parts = [system.orthogonal[system.rows(subset)] for subset in subsets]
    grams = [part.T @ part for part in parts]
    matrix = np.array([[np.sum(left * right) for right in grams] for left in grams])
    count, traces = np.array([len(part) for part in parts]), np.array([np.trace(gram) for gram in grams])
    return HelmertSystem(matrix + np.diag(count - 2 * traces), count - traces)


def variance_components(
    block: Block,
    subsets: Sequence[Subset] | None = None,
    *,
    form: Form = "redundancy",
    tolerance: float = 1e-6,
    max_rounds: int = 50,
    options: Options | None = None,
    **choices: Unpack[Choices],
) -> VarianceComponents:
    """Adjusts a block repeatedly until the sigmas of each group agree with its residuals.

    `subsets`: disjoint groups of observations, the three of `default_groups` if none are given. `form`: "redundancy" or
    "helmert". `tolerance`: maximum relative change of a component at the end. `options` and all other keywords are
    those of `adjust`.

    The sigmas of a group are fixed while its redundancy is below 3, and permanently if it falls below 3 later.

    Raises: BlockError as `adjust`; ValueError for overlapping or inseparable groups, for a robust adjustment, if an
    adjustment fails, and for the form "helmert" of a large block.

    Example:
        >>> rays = jb.statistics.tie_rays(block), jb.statistics.control_rays(block)
        >>> found = jb.statistics.variance_components(block, rays)
        >>> found.converged
        True
    """
    require_a(Block, block, "statistics.variance_components")
    if form not in ("redundancy", "helmert"):
        raise ValueError(f'no form {form!r}; there are "redundancy" and "helmert"')
    wanted = chosen(options, choices, "variance_components")
    if wanted.robust is not None:
        raise ValueError(
            "robust weights and variance components must not be combined: they explain the same residuals; choose one"
        )
    require_valid(block)
    asked = default_groups(block) if subsets is None else tuple(subsets)
    block, groups = with_datum(block), _with_rest(block, asked)
    # redundancy numbers are computed with the cofactors
    quick, fully = (dataclasses.replace(wanted, precision=precision) for precision in (form == "redundancy", True))
    guard, converged, rounds = _Guard(len(groups), len(asked)), False, 0
    while rounds < max_rounds and not converged:
        rounds += 1
        adjustment = adjust(with_components(block, groups, guard.components), quick)
        if adjustment.status is not Status.CONVERGED:
            raise ValueError(f"variance component estimation failed: adjustment {rounds} {adjustment.status.words}")
        block = with_unknowns_of(block, adjustment.block)
        converged = guard.followed(_Step.of(adjustment, groups, form), tolerance)
    last = adjust(with_components(block, groups, guard.components), fully)
    deviations, bounds = _deviations(last, groups, guard.free)
    return VarianceComponents(
        form=form,
        names=tuple(group.name for group in groups),
        observations=tuple(group.count for group in groups),
        redundancy=_redundancy(last, groups),
        components=guard.components,
        deviations=guard.components * deviations,
        deviations_are_bounds=bounds,
        sigmas=np.sqrt([_mean_variance(last.block, group) for group in groups]),
        held=guard.reasons,
        negative=tuple(name for name, was in zip((g.name for g in groups), guard.negative, strict=True) if was),
        rounds=rounds,
        converged=converged,
        adjustment=last,
    )


class _Step(NamedTuple):
    """Sums of one adjustment for its groups; S is None for the form "redundancy"."""

    redundancy: Groups
    squares: Groups
    matrix: Float[np.ndarray, "group group"] | None

    @classmethod
    def of(cls, adjustment: Adjustment, groups: Sequence[Subset], form: Form) -> "_Step":
        """Computes r, q and S of an adjustment."""
        squares = _sums(groups, [np.asarray(v) ** 2 for v in adjustment.weighted_residuals])
        if form == "redundancy":
            return cls(_redundancy(adjustment, groups), squares, None)
        system = helmert_system(dense.dense_system(adjustment), groups)
        return cls(system.redundancy, squares, system.matrix)

    def solution(self, free: Free) -> tuple[Groups, Free]:
        """Computes s: 1 for fixed groups, and a mask of negative Helmert components."""
        simple = np.where(free, self.squares / np.where(free, self.redundancy, 1.0), 1.0)
        if self.matrix is None:
            return simple, np.zeros_like(free)
        s = np.ones(len(free))
        s[free] = np.linalg.solve(
            _separable(self.matrix[np.ix_(free, free)]), (self.squares - self.matrix @ ~free)[free]
        )
        return np.where(s > 0, s, simple), s <= 0


class _Guard:
    """The current components, and the fixed groups."""

    def __init__(self, groups: int, asked: int):
        self.components = np.ones(groups)
        self.rest = np.arange(groups) >= asked
        self.small, self.at_limit, self.negative = (np.zeros(groups, bool) for _ in range(3))
        self._fallen, self._followed = (np.zeros(groups, bool) for _ in range(2))

    @property
    def free(self) -> Free:
        """Mask of the groups with an estimated component."""
        return ~(self.rest | self.small | self.at_limit)

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reason why a group is fixed, "" if it is not."""
        masks = {REST: self.rest, FALLEN: self._fallen, SMALL: self.small, LIMIT: self.at_limit}
        return tuple(next((word for word, mask in masks.items() if mask[k]), "") for k in range(len(self.rest)))

    def followed(self, step: _Step, tolerance: float) -> bool:
        """Whether the components have converged; if not, they are changed by the step."""
        small = ~self.rest & ~self.at_limit & (step.redundancy < MIN_REDUNDANCY)
        self._fallen |= small & self._followed  # otherwise it could alternate for ever
        self.small = small | self._fallen
        back = self.small & (self.components != 1)
        if back.any():
            self.components = np.where(back, 1.0, self.components)
            return False
        s, negative = step.solution(self.free)
        self.negative |= negative
        if np.abs(s - 1).max(initial=0.0) <= tolerance:
            return True
        reached = self.components * np.clip(s, 1 / MAX_STEP, MAX_STEP)
        self.components = np.clip(reached, 1 / MAX_COMPONENT, MAX_COMPONENT)
        self.at_limit |= reached != self.components
        self._followed |= self.free
        return False


def with_components(block: Block, groups: Sequence[Subset], components: Groups) -> Block:
    """The block with the variances of each group multiplied by its component."""
    tables = [np.ones(mask.shape) for mask in groups[0].masks]
    for group, component in zip(groups, components, strict=True):
        for table, mask in zip(tables, group.masks, strict=True):
            table[mask] = component
    return with_sigmas_multiplied(block, [np.sqrt(table) for table in tables])


def _with_rest(block: Block, asked: tuple[Subset, ...]) -> tuple[Subset, ...]:
    """The groups and, if observations remain, a group of the rest; groups must not overlap."""
    taken = tuple(np.zeros_like(mask) for mask in all_observations(block).masks)
    for group in asked:
        if group.count == 0:
            raise ValueError(f"{group.name} has no observations")
        require_whole_members(block, group)
        if any((mask & before).any() for mask, before in zip(group.masks, taken, strict=True)):
            raise ValueError(f"{group.name} shares observations with a group before: an observation has one variance")
        taken = tuple(mask | before for mask, before in zip(group.masks, taken, strict=True))
    everything = all_observations(block)
    rest = Subset("other observations", tuple(m & ~t for m, t in zip(everything.masks, taken, strict=True)))
    return (*asked, rest) if rest.count else asked


def _sums(groups: Sequence[Subset], tables: Sequence[np.ndarray]) -> Groups:
    """Sums of a table of numbers over each group."""
    return np.array([sum(table[mask].sum() for table, mask in zip(tables, g.masks, strict=True)) for g in groups])


def _redundancy(adjustment: Adjustment, groups: Sequence[Subset]) -> Groups:
    return _sums(groups, redundancy_numbers(adjustment))


def _deviations(adjustment: Adjustment, groups: Sequence[Subset], free: Free) -> tuple[Groups, bool]:
    """Relative standard deviations of the components, NaN for fixed groups; True if they are lower bounds.

    S_ii is at most r_i and a diagonal element of S^-1 at least 1 / S_ii.
    """
    deviations = np.full(len(groups), np.nan)
    if adjustment.n_unknowns > dense.MAX_UNKNOWNS:
        deviations[free] = np.sqrt(2 / _redundancy(adjustment, groups)[free])
        return deviations, True
    matrix = helmert_system(dense.dense_system(adjustment), groups).matrix[np.ix_(free, free)]
    deviations[free] = np.sqrt(2 * np.diag(np.linalg.inv(_separable(matrix))))
    return deviations, False


def _separable(matrix: Float[np.ndarray, "group group"]) -> Float[np.ndarray, "group group"]:
    """Returns S. Raises ValueError if the groups are not separable."""
    root = np.sqrt(np.diag(matrix))
    if np.linalg.eigvalsh(matrix / root / root[:, None]).min(initial=1.0) < INSEPARABLE:
        raise ValueError("the variance components of these groups are not separable: join some of the groups")
    return matrix


def _mean_variance(block: Block, group: Subset) -> float:
    """Root of the mean variance of the observations of a group."""
    diagonals = [
        np.asarray(g.sigmas) ** 2 if g.covariances is None else np.diagonal(np.asarray(g.covariances), axis1=1, axis2=2)
        for g in block.groups
    ]
    tables = [np.asarray(block.rays.sigmas) ** 2, *diagonals]
    return float(_sums([group], tables)[0]) / group.count
