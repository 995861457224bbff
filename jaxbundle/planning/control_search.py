"""Optimal positions of k control points: exchange on the covariance, and a lower bound of all layouts.

    C'  = C - C_k (C_kk + S)^-1 C_k^T                      a layout k chosen: one update, no normal equations
    f(z) = tr W (M_0 + sum z_i F_i)^-1 / sum W             convex in 0 <= z <= 1, sum z = k; its minimum is below all
    df/dz_i = - tr F_i (Q W Q)_ii                          F = S^-1: weight of control at a candidate
    f(z) - g^T (z - d) <= f of each layout                d: 1 at the k most negative g, else 0 (Frank & Wolfe 1956)

(Joshi & Boyd 2009, IEEE TSP 57(2) 451: relaxation, rounding, exchange.) The bound may be far below the best layout
where control is much better than the block; its gap is part of the answer.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from jaxbundle.planning.control_candidates import Candidates

CRITERIA = ("mean", "worst")
SWEEPS = 30  # maximum rounds of the exchange; it converges after a few
STEPS = 150  # steps of the relaxation
GAIN = 1e-9  # minimum relative gain of an exchange


class Objective(NamedTuple):
    """The objective: the "mean" or the "worst" of the points' variances, X, Y, Z weighted.

    Example:
        >>> jb.planning.Objective("worst").weights
        (1.0, 1.0, 1.0)
    """

    criterion: str = "mean"
    weights: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def value(self, variances: Float[np.ndarray, "*other target 3"]) -> Float[np.ndarray, "*other"]:
        """The value of the objective for variances."""
        by_point = variances @ (np.asarray(self.weights) / np.sum(self.weights))
        if self.criterion == "mean":
            return np.asarray(by_point.mean(-1))
        # the mean distinguishes layouts with equal worst points
        return np.asarray(by_point.max(-1) + 1e-6 * by_point.mean(-1))


class Layout(NamedTuple):
    """A layout of control points and its result.

    Example:
        >>> candidates = jb.planning.candidates_of(flight.truth, np.arange(4), (0.02, 0.02, 0.03), prior=100.0)
        >>> jb.planning.best_layout(candidates, 3, bound=False).points.shape
        (3,)
    """

    points: Int[np.ndarray, " chosen"]
    """Indices of the points of the block that become control."""
    objective: float
    """Value of the objective in squared object units."""
    variances: Float[np.ndarray, "target 3"]
    bound: float
    """Lower bound of the objective of all layouts with this number of points; NaN if not computed."""

    @property
    def gap(self) -> float:
        """Maximum relative decrease of the objective by another layout."""
        return 1 - self.bound / self.objective


MEAN = Objective()


def best_layout(candidates: Candidates, count: int, objective: Objective = MEAN, bound: bool = True) -> Layout:
    """Finds a layout of `count` points: exchange from a greedy start and from the rounded relaxation.

    Args:
        candidates: covariances of the block with the candidates.
        count: k, number of points.
        objective: the quantity to minimise.
        bound: whether the lower bound is computed; for the mean, and control with errors.

    Raises: ValueError for more points than candidates or an unknown criterion.

    Example:
        >>> candidates = jb.planning.candidates_of(flight.truth, np.arange(4), (0.02, 0.02, 0.03), prior=100.0)
        >>> layout = jb.planning.best_layout(candidates, 3)
        >>> bool(layout.bound <= layout.objective)
        True
    """
    total = len(candidates.points)
    if not 1 <= count <= total:
        raise ValueError(f"{count} control points of {total} candidates; give 1 to {total}")
    if objective.criterion not in CRITERIA:
        raise ValueError(f"criterion {objective.criterion!r} is unknown; there are {', '.join(CRITERIA)}")
    starts, lower = [greedy(candidates, count, objective), spread_start(candidates, count)], np.nan
    if (candidates.noise > 0).all():
        z, lower = relaxation(candidates, count, objective.weights)
        starts.append([int(k) for k in np.argsort(-z, kind="stable")[:count]])
    layouts = [exchange(candidates, start, objective) for start in starts]
    chosen = min(layouts, key=lambda layout: value_of(candidates, layout, objective))
    after = conditioned(candidates, chosen).variances
    lower = lower if bound and objective.criterion == "mean" else np.nan
    return Layout(candidates.points[sorted(chosen)], float(objective.value(after)), after, float(lower))


def spread_start(candidates: Candidates, count: int) -> list[int]:
    """Distant positions: each next one has the largest uncertainty relative to those before it."""
    chosen: list[int] = []
    for _ in range(count):
        own = conditioned(candidates, chosen).own
        size = np.array([np.trace(own[k, :, k]) for k in range(len(own))])
        size[chosen] = -1
        chosen.append(int(size.argmax()))
    return chosen


def value_of(candidates: Candidates, chosen: list[int], objective: Objective) -> float:
    """The objective of a layout, given by indices of candidates."""
    return float(objective.value(conditioned(candidates, chosen).variances))


def conditioned(candidates: Candidates, chosen: list[int]) -> Candidates:
    """The covariances with these candidates as control."""
    if not chosen:
        return candidates
    c, total = candidates.own.shape[1], len(candidates.points)
    own = candidates.own.reshape(total * c, total * c)
    rows = (np.array(chosen)[:, None] * c + np.arange(c)).ravel()
    matrix = own[np.ix_(rows, rows)] + np.diag(np.tile(candidates.noise, len(chosen)))
    factor = scipy.linalg.cholesky(matrix, lower=True)
    half = scipy.linalg.solve_triangular(factor, own[rows], lower=True)
    cross = candidates.cross.reshape(-1, total * c)
    left = scipy.linalg.solve_triangular(factor, cross[:, rows].T, lower=True)
    return candidates._replace(
        variances=candidates.variances - (left**2).sum(0).reshape(-1, 3),
        cross=(cross - left.T @ half).reshape(candidates.cross.shape),
        own=(own - half.T @ half).reshape(candidates.own.shape),
    )


def after_each(candidates: Candidates, objective: Objective) -> Float[np.ndarray, " candidate"]:
    """The objective with each candidate added to the selection."""
    total, c = candidates.own.shape[:2]
    matrices = candidates.own[np.arange(total), :, np.arange(total)] + np.diag(candidates.noise)
    # a fixed candidate that is already selected adds no information
    inverse = np.linalg.pinv(matrices, hermitian=True)
    by_candidate = candidates.cross.transpose(2, 0, 1, 3)
    told = by_candidate @ inverse[:, None]
    return objective.value(candidates.variances - (told * by_candidate).sum(-1))


def greedy(candidates: Candidates, count: int, objective: Objective) -> list[int]:
    """Adds one point after the other, each with the largest gain."""
    chosen: list[int] = []
    for _ in range(count):
        values = after_each(conditioned(candidates, chosen), objective)
        values[chosen] = np.inf
        chosen.append(int(values.argmin()))
    return chosen


def exchange(candidates: Candidates, start: list[int], objective: Objective) -> list[int]:
    """Exchanges one point at a time for a better position until there is no gain (Fedorov 1972)."""
    chosen, value = list(start), value_of(candidates, start, objective)
    for _ in range(SWEEPS):
        before = value
        for k in range(len(chosen)):
            others = [*chosen[:k], *chosen[k + 1 :]]
            values = after_each(conditioned(candidates, others), objective)
            values[others] = np.inf
            best = int(values.argmin())
            if values[best] < value * (1 - GAIN):
                chosen[k], value = best, float(values[best])
        if value >= before * (1 - GAIN):
            return chosen
    return chosen


def relaxation(
    candidates: Candidates, count: int, weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> tuple[Float[np.ndarray, " candidate"], float]:
    """Shares z of the candidates with the smallest mean variance, by projected gradients, and the lower bound.

    Raises: ValueError for errorless control, which cannot be divided.
    """
    if not (candidates.noise > 0).all():
        raise ValueError("errorless control cannot be divided: give sigmas for a lower bound")
    relaxed = _Relaxed(candidates, np.asarray(weights) / np.sum(weights))
    z = np.full(len(candidates.points), count / len(candidates.points))
    value, gradient = relaxed(z)
    step, bound = 0.1 / np.abs(gradient).max(), -np.inf
    for _ in range(STEPS):
        while True:
            trial = onto_capped_simplex(z - step * gradient, count)
            new, new_gradient = relaxed(trial)
            if new <= value + gradient @ (trial - z) + ((trial - z) ** 2).sum() / (2 * step) or step < 1e-12:
                break
            step /= 2
        z, value, gradient, step = trial, new, new_gradient, step * 1.5
        best = np.argsort(gradient)[:count]
        bound = max(bound, value - float(gradient @ z - gradient[best].sum()))
        if value - bound < 1e-4 * value:
            break
    return z, float(bound)


class _Relaxed:
    """The function f and its gradient."""

    def __init__(self, candidates: Candidates, weights: Float[np.ndarray, "3"]):
        total, c = candidates.own.shape[:2]
        self.own = candidates.own.reshape(total * c, total * c)
        cross = candidates.cross.reshape(-1, total * c)
        of_rows = np.tile(weights, len(candidates.judged)) / len(candidates.judged)
        self.products = cross.T @ (of_rows[:, None] * cross)
        self.start = float(of_rows @ candidates.variances.ravel())
        self.information = np.tile(1 / candidates.noise, total)
        self.size = c

    def __call__(self, z: Float[np.ndarray, " candidate"]) -> tuple[float, Float[np.ndarray, " candidate"]]:
        root = np.sqrt(np.repeat(np.maximum(z, 0.0), self.size) * self.information)
        matrix = root[:, None] * self.own * root + np.eye(len(root))
        factor = scipy.linalg.cho_factor(matrix, lower=True)
        # Q_c = (I - own R M^-1 R) applied from the left gives the covariances after the control
        gain = root[:, None] * scipy.linalg.cho_solve(factor, np.diag(root))
        left = np.eye(len(root)) - self.own @ gain
        value = self.start - float(np.sum(gain * self.products))
        after = np.einsum("ij,jk,ik->i", left, self.products, left, optimize=True)
        return value, -(self.information * after).reshape(-1, self.size).sum(1)


def onto_capped_simplex(z: Float[np.ndarray, " candidate"], total: float) -> Float[np.ndarray, " candidate"]:
    """The nearest z with 0 <= z <= 1 and this sum, by bisection of the shift."""
    low, high = z.min() - 1.0, z.max()
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.clip(z - middle, 0, 1).sum() > total else (low, middle)
    return np.clip(z - (low + high) / 2, 0, 1)
