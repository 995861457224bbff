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

    Ends when the residual is at most `tolerance` times the first one, in the norm of the preconditioner. The second
    value is the remaining ratio, NaN if A is not positive definite.
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


def softest_direction(
    product: Callable[[T], T],
    precondition: Callable[[T], T],
    right: T,
    dot: Callable[[T, T], Array],
    limit: float,
    tolerance: float,
    most_iterations: int,
) -> T:
    """A direction x with a small quotient x^T A x / x^T M x, where M^-1 is the preconditioner.

    It is A^-1 b, one step of inverse iteration from `right`, or, for singular A, the first search direction with a
    quotient of at most `limit`. Ends like `conjugate_gradients`. Not finite if the preconditioner is not finite.
    """

    def plus(x: T, factor: Array, y: T) -> T:
        return jax.tree.map(lambda a, b: a + factor * b, x, y)

    def soft(ap: T, p: T, mp: T) -> Array:
        return ~(dot(p, ap) > limit * dot(p, mp))

    def step(carry: tuple) -> tuple:
        k, x, r, p, ap, mp, rz = carry
        alpha = rz / dot(p, ap)
        r = plus(r, -alpha, ap)
        z = precondition(r)
        new = dot(r, z)
        p_new, mp_new = plus(z, new / rz, p), plus(r, new / rz, mp)
        return k + 1, plus(x, alpha, p), r, p_new, product(p_new), mp_new, new

    z = precondition(right)
    first = dot(right, z)
    zero = jax.tree.map(jnp.zeros_like, right)

    def going(carry: tuple) -> Array:
        k, _, _, p, ap, mp, rz = carry
        return (k < most_iterations) & (rz > tolerance**2 * first) & ~soft(ap, p, mp)

    _, x, _, p, ap, mp, rz = lax.while_loop(going, step, (0, zero, right, z, product(z), right, first))
    is_soft = (rz > tolerance**2 * first) & soft(ap, p, mp)
    return jax.tree.map(lambda a, b: jnp.where(is_soft, a, b), p, x)
