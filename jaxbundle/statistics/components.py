"""Variance components: how exact every group of observations was after all, and with it the weights between groups.

    r_i = n_i - tr(N^-1 N_i),    N_i = A_i^T P_i A_i                                  sum r_i = M - N
    q_i = v_i^T P_i v_i
    "redundancy"   s_i = q_i / r_i                                                   (Foerstner 1979)
    "helmert"      S s = q,    S_ij = delta_ij (n_i - 2 tr N^-1 N_i) + tr(N^-1 N_i N^-1 N_j)      (Helmert 1907)

The sigmas of group i are multiplied by sqrt(s_i) and the block is adjusted again, until all s_i are 1. As the rows of S
sum up to r_i, both forms end at the same place, q_i = r_i. There normal errors give q the covariance 2 S, so that of
the components is 2 S^-1, in units of the components.

The component of group i is the product of its s_i: its variance of unit weight for the sigmas a priori. Ratios of
components are the coefficients of coordination C_i^2 = mu_1^2 / mu_i^2 of the text 001.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Unpack

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.block.validate import require_valid
from jaxbundle.numerics.host import on_device
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.options import Choices, Options, chosen
from jaxbundle.statistics import dense
from jaxbundle.statistics.reliability_tables import redundancy_numbers
from jaxbundle.statistics.subsets import Subset, all_observations, require_whole_members, three_groups

Form = Literal["redundancy", "helmert"]
Groups = Float[np.ndarray, " group"]
Free = Bool[np.ndarray, " group"]
LEAST_REDUNDANCY = 3.0  # of a group: with less, the standard deviation of its component exceeds 0.8 of it
LARGEST_STEP = 100.0  # of a component in one round
LARGEST_COMPONENT = 1e6  # or its inverse: sigmas a thousand times off are no matter of weights any more
INSEPARABLE = 1e-10  # smallest eigenvalue of S with a unit diagonal
REST = "not asked for"
SMALL = f"redundancy below {LEAST_REDUNDANCY:g}"
FALLEN = f"on the way to a smaller one its redundancy fell below {LEAST_REDUNDANCY:g}"
LIMIT = f"beyond {LARGEST_COMPONENT:g} or its inverse"


class HelmertSystem(NamedTuple):
    """S and the redundancy r of every group, its row sum."""

    matrix: Float[np.ndarray, "group group"]
    redundancy: Groups


@dataclass(frozen=True)
class VarianceComponents:
    """Variance components, one a group, in the order asked for; what was not asked for comes last.

    `components` multiply the variances a priori, `factors`, their roots, the sigmas. `deviations` are the components'
    standard deviations, NaN for a group that is `held`, which says why ("" if it is not); where the block is too large
    for S they are lower bounds, sqrt(2 / r_i). `adjustment` is the last one, with the sigmas that it found.
    """

    form: Form
    names: tuple[str, ...]
    observations: tuple[int, ...]
    redundancy: Groups
    components: Groups
    deviations: Groups
    deviations_are_bounds: bool
    sigmas: Groups  # roots of the mean variance of an observation, a posteriori
    held: tuple[str, ...]
    negative: tuple[str, ...]  # groups whose Helmert component was negative on the way
    rounds: int
    converged: bool
    adjustment: Adjustment

    @property
    def factors(self) -> Groups:
        """What the sigmas a priori are to be multiplied by."""
        return np.sqrt(self.components)

    @property
    def factor_deviations(self) -> Groups:
        """Standard deviations of the factors."""
        return self.deviations / (2 * self.factors)

    @property
    def coordination(self) -> Groups:
        """C_i^2 = s_1^2 / s_i^2: factors of the weights 1 / sigma^2 a priori, those of the first group kept."""
        return self.components[0] / self.components

    def summary(self) -> str:
        """A table, and what is to be known of it."""
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
            f"{name}: the component was negative on the way, the redundancy form's was taken" for name in self.negative
        ]
        return "\n".join(lines)


def helmert_system(system: dense.DenseSystem, subsets: Sequence[Subset]) -> HelmertSystem:
    """S by the orthogonal factor U of A: tr(N^-1 N_i N^-1 N_j) = tr(G_i G_j), G_i = U_i^T U_i."""
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
    """Adjusts a block again and again until every group's sigmas agree with its residuals.

    `subsets`: disjoint groups of observations, the three of `three_groups` if none are given. `form`: "redundancy" or
    "helmert". `tolerance`: largest relative change of a component at the end. `options` and all other keywords are
    those of `adjust`.

    A group keeps its sigmas a priori while its redundancy is below 3, and for good if it falls below later.

    Raises: BlockError as `adjust`; ValueError for overlapping or inseparable groups, for a robust adjustment, where an
    adjustment fails, and for the form "helmert" of a large block.
    """
    require_a(Block, block, "statistics.variance_components")
    if form not in ("redundancy", "helmert"):
        raise ValueError(f'no form {form!r}; there are "redundancy" and "helmert"')
    wanted = chosen(options, choices, "variance_components")
    if wanted.robust is not None:
        raise ValueError("robust weights and variance components explain the same residuals twice: choose one")
    require_valid(block)
    asked = three_groups(block) if subsets is None else tuple(subsets)
    block, groups = with_datum(block), _with_rest(block, asked)
    # redundancy numbers come with the cofactors
    quick, fully = (dataclasses.replace(wanted, precision=precision) for precision in (form == "redundancy", True))
    guard, converged, rounds = _Guard(len(groups), len(asked)), False, 0
    while rounds < max_rounds and not converged:
        rounds += 1
        adjustment = adjust(with_components(block, groups, guard.components), quick)
        if adjustment.status is not Status.CONVERGED:
            raise ValueError(f"no variance components: adjustment {rounds} on the way {adjustment.status.words}")
        block = _moved_on(block, adjustment)
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
    """What one adjustment says of its groups; S is None for the form "redundancy"."""

    redundancy: Groups
    squares: Groups
    matrix: Float[np.ndarray, "group group"] | None

    @classmethod
    def of(cls, adjustment: Adjustment, groups: Sequence[Subset], form: Form) -> "_Step":
        """r, q and S of an adjustment."""
        squares = _sums(groups, [np.asarray(v) ** 2 for v in adjustment.weighted_residuals])
        if form == "redundancy":
            return cls(_redundancy(adjustment, groups), squares, None)
        system = helmert_system(dense.dense_system(adjustment), groups)
        return cls(system.redundancy, squares, system.matrix)

    def solution(self, free: Free) -> tuple[Groups, Free]:
        """s, 1 for what is held, and where Helmert's was negative."""
        simple = np.where(free, self.squares / np.where(free, self.redundancy, 1.0), 1.0)
        if self.matrix is None:
            return simple, np.zeros_like(free)
        s = np.ones(len(free))
        s[free] = np.linalg.solve(
            _separable(self.matrix[np.ix_(free, free)]), (self.squares - self.matrix @ ~free)[free]
        )
        return np.where(s > 0, s, simple), s <= 0


class _Guard:
    """The components reached, and which groups are held."""

    def __init__(self, groups: int, asked: int):
        self.components = np.ones(groups)
        self.rest = np.arange(groups) >= asked
        self.small, self.at_limit, self.negative = (np.zeros(groups, bool) for _ in range(3))
        self._fallen, self._followed = (np.zeros(groups, bool) for _ in range(2))

    @property
    def free(self) -> Free:
        """Groups whose component is estimated."""
        return ~(self.rest | self.small | self.at_limit)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why a group is held, "" if it is not."""
        masks = {REST: self.rest, FALLEN: self._fallen, SMALL: self.small, LIMIT: self.at_limit}
        return tuple(next((word for word, mask in masks.items() if mask[k]), "") for k in range(len(self.rest)))

    def followed(self, step: _Step, tolerance: float) -> bool:
        """Whether the step leaves the components where they are; else they follow it."""
        small = ~self.rest & ~self.at_limit & (step.redundancy < LEAST_REDUNDANCY)
        self._fallen |= small & self._followed  # once freed and fallen again, it would go on so for ever
        self.small = small | self._fallen
        back = self.small & (self.components != 1)
        if back.any():
            self.components = np.where(back, 1.0, self.components)
            return False
        s, negative = step.solution(self.free)
        self.negative |= negative
        if np.abs(s - 1).max(initial=0.0) <= tolerance:
            return True
        reached = self.components * np.clip(s, 1 / LARGEST_STEP, LARGEST_STEP)
        self.components = np.clip(reached, 1 / LARGEST_COMPONENT, LARGEST_COMPONENT)
        self.at_limit |= reached != self.components
        self._followed |= self.free
        return False


def with_components(block: Block, groups: Sequence[Subset], components: Groups) -> Block:
    """The block with the variances of every group multiplied by its component."""
    tables = [np.ones(mask.shape) for mask in groups[0].masks]
    for group, component in zip(groups, components, strict=True):
        for table, mask in zip(tables, group.masks, strict=True):
            table[mask] = component

    def scaled(group: ObservationGroup, table: np.ndarray) -> ObservationGroup:
        sigmas = on_device(np.asarray(group.sigmas) * np.sqrt(table))
        if group.covariances is None:
            return eqx.tree_at(lambda g: g.sigmas, group, sigmas)
        # of one member all observed components have the same factor; what is not observed counts nothing
        largest = np.where(group.structure.observed, table, 0.0).max(1)[:, None, None]
        covariances = on_device(np.asarray(group.covariances) * np.where(largest > 0, largest, 1.0))
        return eqx.tree_at(lambda g: (g.sigmas, g.covariances), group, (sigmas, covariances))

    rays = on_device(np.asarray(block.rays.sigmas) * np.sqrt(tables[0]))
    scaled_groups = tuple(scaled(group, table) for group, table in zip(block.groups, tables[1:], strict=True))
    return eqx.tree_at(lambda b: (b.rays.sigmas, b.groups), block, (rays, scaled_groups))


def _with_rest(block: Block, asked: tuple[Subset, ...]) -> tuple[Subset, ...]:
    """The groups and, where they are not all observations, the rest; they must not overlap."""
    taken = tuple(np.zeros_like(mask) for mask in all_observations(block).masks)
    for group in asked:
        if group.count == 0:
            raise ValueError(f"no observations belong to {group.name}")
        require_whole_members(block, group)
        if any((mask & before).any() for mask, before in zip(group.masks, taken, strict=True)):
            raise ValueError(f"{group.name} shares observations with a group before: an observation has one variance")
        taken = tuple(mask | before for mask, before in zip(group.masks, taken, strict=True))
    everything = all_observations(block)
    rest = Subset("other observations", tuple(m & ~t for m, t in zip(everything.masks, taken, strict=True)))
    return (*asked, rest) if rest.count else asked


def _moved_on(block: Block, adjustment: Adjustment) -> Block:
    """The block, its sigmas a priori, at the adjusted unknowns."""
    new = adjustment.block
    return eqx.tree_at(
        lambda b: (b.exterior, b.interior, b.parameters, b.object_points),
        block,
        (new.exterior, new.interior, new.parameters, new.object_points),
    )


def _sums(groups: Sequence[Subset], tables: Sequence[np.ndarray]) -> Groups:
    """Sums of a table of numbers over every group."""
    return np.array([sum(table[mask].sum() for table, mask in zip(tables, g.masks, strict=True)) for g in groups])


def _redundancy(adjustment: Adjustment, groups: Sequence[Subset]) -> Groups:
    return _sums(groups, redundancy_numbers(adjustment))


def _deviations(adjustment: Adjustment, groups: Sequence[Subset], free: Free) -> tuple[Groups, bool]:
    """Relative standard deviations of the components, NaN for what is held; True where they are lower bounds.

    S_ii is at most r_i and a diagonal element of S^-1 at least 1 / S_ii.
    """
    deviations = np.full(len(groups), np.nan)
    if adjustment.unknowns > dense.MAX_UNKNOWNS:
        deviations[free] = np.sqrt(2 / _redundancy(adjustment, groups)[free])
        return deviations, True
    matrix = helmert_system(dense.dense_system(adjustment), groups).matrix[np.ix_(free, free)]
    deviations[free] = np.sqrt(2 * np.diag(np.linalg.inv(_separable(matrix))))
    return deviations, False


def _separable(matrix: Float[np.ndarray, "group group"]) -> Float[np.ndarray, "group group"]:
    """S, unless some of its groups cannot be told apart."""
    root = np.sqrt(np.diag(matrix))
    if np.linalg.eigvalsh(matrix / root / root[:, None]).min(initial=1.0) < INSEPARABLE:
        raise ValueError(
            "the residuals do not tell the variance components of the groups apart: join some of the groups"
        )
    return matrix


def _mean_variance(block: Block, group: Subset) -> float:
    """Mean variance of the observations of a group."""
    diagonals = [
        np.asarray(g.sigmas) ** 2 if g.covariances is None else np.diagonal(np.asarray(g.covariances), axis1=1, axis2=2)
        for g in block.groups
    ]
    tables = [np.asarray(block.rays.sigmas) ** 2, *diagonals]
    return float(_sums([group], tables)[0]) / group.count
