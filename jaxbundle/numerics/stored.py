"""Values kept in memory between two parts of a program."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

T = TypeVar("T")


@jax.custom_jvp
def stored(values: T, zero: Int[Array, ""]) -> T:
    """The same values, each computed once, and so are their derivatives.

    What several expressions have in common XLA computes in each of them again (on CPUs; `optimization_barrier` does not
    keep it from that). It stops at a loop: this one makes no turn, `zero` is a 0 that only the running program knows.
    """
    return lax.fori_loop(0, zero, lambda _, v: jax.tree.map(jnp.negative, v), values)


@stored.defjvp
def _stored_jvp(primals: tuple, tangents: tuple) -> tuple:
    zero = primals[1]

    def linear(moved: Array) -> Array:
        # the equations I x = b: what JAX transposes without looking into their solution; one by one, since some of
        # the values may have no derivative
        solve = lambda _, b: lax.fori_loop(0, zero, lambda _, v: -v, b)  # noqa: E731
        return lax.custom_linear_solve(lambda x: x, moved, solve, symmetric=True)

    return stored(*primals), jax.tree.map(linear, tangents[0])
