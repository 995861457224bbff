"""The history of a solve: one entry per iteration, in arrays of fixed size, so that it works under jit."""

from collections.abc import Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.numerics.host import on_device

HistoryEntry = tuple[int, float, float, float, bool]
"""Index of an iteration, cost, damping, step, and whether the step was applied."""


class History(NamedTuple):
    """Numbers of all iterations in order; unused entries are NaN and False."""

    cost: Float[Array, " iteration"]
    """v^T P v / 2 after the iteration."""
    damping: Float[Array, " iteration"]
    """The damping lambda of the step; 0 for a full step of Gauss-Newton."""
    step: Float[Array, " iteration"]
    """|J d| / |v|: the length of the step in the space of the residuals, without a unit."""
    accepted: Bool[Array, " iteration"]
    """Whether the step was applied."""

    def with_entry(self, at: Int[Array, ""], entry: "History") -> "History":
        """The history with the entry of one iteration; each field of `entry` is a scalar."""
        return History(*(array.at[at].set(value) for array, value in zip(self, entry, strict=True)))


def empty_history(max_iterations: int) -> History:
    """The history of a solve before its first iteration."""
    unknown = np.full(max_iterations, np.nan)
    return History(*on_device((unknown, unknown, unknown, np.zeros(max_iterations, bool))))


def history_of(entries: Iterable[HistoryEntry], max_iterations: int) -> History:
    """The history of entries that the host has collected: index, cost, damping, step, accepted."""
    arrays = [np.full(max_iterations, np.nan) for _ in range(3)] + [np.zeros(max_iterations, bool)]
    for index, *values in entries:
        for array, value in zip(arrays, values, strict=True):
            array[index] = value
    return History(*on_device(arrays))


def entry(cost: Array, damping: Array, step: Array, accepted: Array) -> History:
    """The entry of one iteration for `with_entry`."""
    return History(*map(jnp.asarray, (cost, damping, step, accepted)))
