"""Values kept in memory between two parts of a program."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

T = TypeVar("T")


def stored(values: T, zero: Int[Array, ""]) -> T:
    """The same values, each computed once.

    What several expressions have in common XLA computes in each of them again (on CPUs; `optimization_barrier` does not
    keep it from that). It stops at a loop: this one makes no turn, `zero` is a 0 that only the running program knows.
    """
    return lax.fori_loop(0, zero, lambda _, v: jax.tree.map(jnp.negative, v), values)
