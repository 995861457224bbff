"""Derivatives along a direction, and linear functions with an explicit transposed function."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

LinearFunction = Callable[[Float[Array, " m"]], Float[Array, " n"]]


def directional(function: Callable, at: tuple, direction: tuple) -> tuple[Any, Any]:
    """Value and directional derivative of a function; None in `direction` means a constant argument."""
    value, moved = eqx.filter_jvp(function, at, direction)
    return value, jax.tree.map(lambda x, m: jnp.zeros_like(x) if m is None else m, value, moved)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _without_derivative(x: Array, reason: str) -> Array:
    return x


@_without_derivative.defjvp
def _without_derivative_jvp(reason: str, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    raise ValueError(reason)


def linear_map(
    forward: LinearFunction, transposed: LinearFunction, x: Float[Array, " m"], size: int, given: Any, reason: str
) -> Float[Array, " size"]:
    """The linear function L x = forward(x), which JAX transposes by `transposed` (L^T) and can batch.

    `given`: all numbers that L depends on. Derivatives with respect to them are not available.

    Raises: ValueError with the `reason` if JAX requests such a derivative.
    """
    numbers = jax.tree.leaves(eqx.filter(given, eqx.is_inexact_array))
    unknown = _without_derivative(sum((jnp.sum(leaf) for leaf in numbers), jnp.zeros(())), reason)
    split = len(x)

    # the equations [ I  0; -L  I ] [ u; v ] = [ x; 0 ], for which JAX needs both solutions
    def solve(_: Any, b: Array) -> Array:
        return jnp.concatenate([b[:split], b[split:] + forward(b[:split])])

    def transpose_solve(_: Any, b: Array) -> Array:
        return jnp.concatenate([b[:split] + transposed(b[split:]), b[split:]])

    right = jnp.concatenate([x, jnp.zeros(size)])
    # "symmetric" only prevents JAX from transposing the product, which is not used
    return lax.custom_linear_solve(lambda z: unknown * z, right, solve, transpose_solve, symmetric=True)[split:]
