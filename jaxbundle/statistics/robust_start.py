"""Values of the unknowns without the influence of large errors, for linear tests.

Least squares distribute an error of a thousand sigmas over the whole block, so its neighbours also seem wrong. With
weights of all observations that decrease with the residuals, the other observations determine the block:

    first    w = 1 / max(1, |v| / k s)          nearly minimum absolute values: has one minimum (Huber 1964)
    then     w = 1 / (1 + (v / k s)^2)^2        large residuals have no influence (Geman and McClure 1985)

v are residuals over their sigmas, s their scale, 1.48 times the median of |v|, and at least 1.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_sigmas_multiplied, with_unknowns_of
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.attempt import attempt

LIMIT = 2.0  # k: normal errors up to this size have full weight at first
FIRST, THEN = 3, 3  # rounds
LEAST = 1e-6  # weight
NORMAL = 1.4826  # ratio of standard deviation and median of the absolute values of normal errors

Members = tuple[Float[np.ndarray, " _member"], ...]


class RobustPoint(NamedTuple):
    """A block at robust values of its unknowns, and its residuals over the given sigmas."""

    block: Block
    weighted_residuals: tuple[np.ndarray, ...]


def robust_point(adjustment: Adjustment) -> RobustPoint | None:
    """Computes the robust values; None if the iterations do not converge."""
    given = adjustment.block
    residuals = tuple(np.asarray(v) for v in adjustment.weighted_residuals)
    block = given
    for round_ in range(FIRST + THEN):
        weights = _weights(residuals, round_ >= FIRST)
        again = attempt(_weighted(given, block, weights))
        if again is None:
            return None
        roots = [np.sqrt(w)[:, None] for w in weights]
        residuals = tuple(np.asarray(v) / w for v, w in zip(again.weighted_residuals, roots, strict=True))
        block = again.block
    return RobustPoint(with_unknowns_of(given, block), residuals)


def _weights(residuals: Sequence[np.ndarray], redescending: bool) -> Members:
    """Weights of all members: all components of a member have the minimum weight."""
    sizes = np.concatenate([np.abs(v[v != 0]) for v in residuals])
    scale = LIMIT * max(NORMAL * float(np.median(sizes)), 1.0) if len(sizes) else 1.0
    relative = [np.abs(v).max(1, initial=0.0) / scale for v in residuals]
    if redescending:
        return tuple(np.maximum(1 / (1 + x**2) ** 2, LEAST) for x in relative)
    return tuple(np.maximum(1 / np.maximum(x, 1.0), LEAST) for x in relative)


def _weighted(given: Block, start: Block, weights: Members) -> Block:
    """The block with these additional weights, at the unknowns of `start`."""
    return with_sigmas_multiplied(with_unknowns_of(given, start), [1 / np.sqrt(w)[:, None] for w in weights])
