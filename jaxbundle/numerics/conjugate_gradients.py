"""Preconditioned conjugate gradients for symmetric positive definite equations (Hestenes & Stiefel 1952)."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

T = TypeVar("T")


def conjugate_gradients(
    product: Callable[[T], T],
    precondition: Callable[[T], T],
    right: T,
    dot: Callable[[T, T], Array],
    tolerance: float,
    most_iterations: int,
) -> tuple[T, Array]:
    """Solution of A x = right, started at 0, for vectors that are pytrees with a scalar product `dot`.

    Ends where the residual has fallen to `tolerance` of the first one, in the norm of the preconditioner; the second
    value is the share that is left, NaN where A is not positive definite.
    """

    def plus(x: T, factor: Array, y: T) -> T:
        return jax.tree.map(lambda a, b: a + factor * b, x, y)

    def step(carry: tuple) -> tuple:
        k, x, r, p, rz = carry
        ap = product(p)
        curvature = dot(p, ap)
        alpha = rz / jnp.where(curvature > 0, curvature, jnp.nan)
        r = plus(r, -alpha, ap)
        z = precondition(r)
        new = dot(r, z)
        return k + 1, plus(x, alpha, p), r, plus(z, new / rz, p), new

    z = precondition(right)
    first = dot(right, z)
    zero = jax.tree.map(jnp.zeros_like, right)
    going = lambda c: (c[0] < most_iterations) & (c[4] > tolerance**2 * first)  # noqa: E731
    _, x, _, _, last = lax.while_loop(going, step, (0, zero, right, z, first))
    return x, jnp.sqrt(last / jnp.where(first == 0, 1.0, first))
