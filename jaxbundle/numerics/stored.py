"""Values stored in memory between two parts of a program."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

T = TypeVar("T")


@jax.custom_jvp
def stored(values: T, zero: Int[Array, ""]) -> T:
    """Returns the values, each computed only once, also for their derivatives.

    XLA recomputes common parts of several expressions in each of them (on CPUs; `optimization_barrier` does not prevent
    that). A loop prevents it: this one has no iterations, as `zero` is a 0 that is known only at run time.
    """
    return lax.fori_loop(0, zero, lambda _, v: jax.tree.map(jnp.negative, v), values)


@stored.defjvp
def _stored_jvp(primals: tuple, tangents: tuple) -> tuple:
    zero = primals[1]

    def linear(moved: Array) -> Array:
        # the equations I x = b: JAX transposes them without tracing their solution; one by one, since some of the
        # # values may have no derivative
        solve = lambda _, b: lax.fori_loop(0, zero, lambda _, v: -v, b)  # noqa: E731
        return lax.custom_linear_solve(lambda x: x, moved, solve, symmetric=True)

    return stored(*primals), jax.tree.map(linear, tangents[0])
