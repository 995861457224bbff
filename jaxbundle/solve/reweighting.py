"""Robust estimation by iterated reweighting: gross errors are down-weighted and listed.

    minimise  sum rho(t),    t = sqrt(v_x^2 / s_x^2 + v_y^2 / s_y^2) / s      of each ray
    weight    w(t) = rho'(t) / t                                              of the next least-squares adjustment

s is a robust standard deviation of unit weight of the rays: the median of t, divided by the median length of a standard
normal vector (sqrt(2 ln 2) in the plane) and by the square root of the mean redundancy number, since residuals are
smaller than errors. Weight functions that give large residuals no influence have many minima: they start from Huber's.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import gammaincinv

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.numerics.host import on_device, tree_with
from jaxbundle.solve.adjustment import Adjustment, Reweighting, Status
from jaxbundle.solve.weight_functions import AbstractWeightFunction, Huber, with_weights

SETTLED = 1e-4  # maximum change of a converged weight
MAX_ROUNDS = 50
FAILED_ROUNDS = 2  # successive failed adjustments: one may have a distant start, after two the next is not better


class Solve(NamedTuple):
    """The functions for the adjustments between two changes of the weights, and for the last one."""

    quickly: Callable[[Block], Adjustment]
    fully: Callable[[Block], Adjustment]


def adjust_robustly(block: Block, function: AbstractWeightFunction, solve: Solve) -> Adjustment:
    """Adjusts with weights that follow from the residuals; the given sigmas are not changed.

    Raises: ValueError under tracing.
    """
    if not block.concrete:
        raise ValueError("robust estimation does not work inside jit, grad and vmap")
    end = _rounds(block, function, solve)
    last = end.adjustment
    if last.status is not Status.INTERRUPTED:
        try:
            last = solve.fully(with_weights(last.block, np.asarray(block.rays.sigmas), end.weights))
        except KeyboardInterrupt:
            last = _interrupted(last)
    weights = on_device(end.weights)
    reweighting = Reweighting(function.name, function.limit, end.rounds, weights, end.settled)
    restored = eqx.tree_at(lambda b: b.rays.sigmas, last.block, block.rays.sigmas)
    if end.failed:
        last = dataclasses.replace(last, findings=(*last.findings, _given_up(end)))
    return eqx.tree_at(
        lambda a: (a.block, a.reweighting), last, (restored, reweighting), is_leaf=lambda leaf: leaf is None
    )


class _End(NamedTuple):
    """The end of the rounds: the last adjustment. `failed`: the last adjustments, if they did not converge."""

    adjustment: Adjustment
    weights: np.ndarray
    rounds: int
    settled: bool
    failed: list[Status]


def _rounds(block: Block, function: AbstractWeightFunction, solve: Solve) -> _End:
    """Alternates weights and adjustments until the weights converge or the adjustments fail."""
    sigmas = np.asarray(block.rays.sigmas)
    weights, rounds, settled, failed = np.ones(len(sigmas)), 0, False, []
    start = solve.quickly(block)
    first = Huber() if function.redescending else function
    try:
        for now in dict.fromkeys((first, function)):
            for _ in range(MAX_ROUNDS):
                if start.status is Status.INTERRUPTED:
                    return _End(start, weights, rounds, False, [])
                rounds += 1
                t = normed_lengths(start, sigmas, weights)
                if not np.isfinite(t).all():
                    return _End(start, weights, rounds, False, [start.status])
                new = np.asarray(now.weights(on_device(t)))
                settled = bool(np.abs(new - weights).max(initial=0.0) < SETTLED)
                start, weights = solve.quickly(with_weights(start.block, sigmas, new)), new
                failed = [] if start.status is Status.CONVERGED else [*failed, start.status]
                if len(failed) == FAILED_ROUNDS:
                    return _End(start, weights, rounds, False, failed)
                if settled:
                    break
    except KeyboardInterrupt:  # in a solve without an accepted step: the previous one is used
        return _End(_interrupted(start), weights, rounds, False, [])
    return _End(start, weights, rounds, settled, [])


def _interrupted(adjustment: Adjustment) -> Adjustment:
    return tree_with(lambda a: a.iterations.status, adjustment, int(Status.INTERRUPTED))


def _given_up(end: _End) -> Finding:
    """The finding about weights that did not converge."""
    return Finding(
        Kind.UNSETTLED,
        f"the robust weights did not converge: in round {end.rounds} the adjustment {end.failed[-1].words}",
        "first cure the problem of the adjustment without robust weights",
        (Subject("rays"),),
    )


def normed_lengths(adjustment: Adjustment, sigmas: np.ndarray, weights: np.ndarray) -> Float[np.ndarray, " ray"]:
    """Computes t of each ray; the scale comes from the rays that have a weight."""
    t = np.linalg.norm(np.asarray(adjustment.residuals[0]) / sigmas, axis=1)
    redundancy = np.clip(adjustment.redundancy / adjustment.n_observations, 0.05, 1.0)
    scale = np.median(t[weights > 0.01] if (weights > 0.01).any() else t) / np.sqrt(redundancy)
    scale /= median_length(sigmas.shape[1])
    return t / max(scale, np.finfo(float).tiny)


def median_length(components: int) -> float:
    """Median length of a vector with n standard normal components; sqrt(2 ln 2) for n = 2."""
    return float(np.sqrt(2 * gammaincinv(components / 2, 0.5)))
