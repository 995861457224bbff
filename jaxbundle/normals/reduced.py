"""The reduced normal equations, dense: Cholesky factorisation, solution, weakness of its unknowns."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float


class ReducedFactor(NamedTuple):
    """Lower Cholesky factor of the scaled matrix, the scale, and the share of each diagonal that elimination left."""

    lower: Float[Array, "kept kept"]
    scale: Float[Array, " kept"]
    pivots: Float[Array, " kept"]


def factorise(
    reduced: Float[Array, "kept kept"], diagonal: Float[Array, " kept"], damping: Array, free: Bool[Array, " kept"]
) -> ReducedFactor:
    """Factorises the reduced matrix with `damping` times `diagonal` added; held unknowns get a unit row.

    The matrix is scaled to the unit diagonal of N first, so a pivot is the share of an unknown's own normal equation
    that no other unknown can imitate: 0 for an undetermined one.
    """
    scale = jnp.where(free, 1 / jnp.sqrt(jnp.where(free, diagonal, 1.0)), 0.0)
    scaled = scale[:, None] * reduced * scale[None, :] + jnp.diag(jnp.where(free, damping, 1.0))
    lower = jnp.linalg.cholesky(scaled, symmetrize_input=False)
    return ReducedFactor(lower, scale, jnp.diagonal(lower) ** 2)


def solve(factor: ReducedFactor, right: Float[Array, "kept *columns"]) -> Float[Array, "kept *columns"]:
    """Solution for one or several right-hand sides; 0 for held unknowns."""
    scale = factor.scale if right.ndim == 1 else factor.scale[:, None]
    return scale * cho_solve((factor.lower, True), scale * right)


def inverse(factor: ReducedFactor) -> Float[Array, "kept kept"]:
    """Cofactor matrix of the kept unknowns; rows and columns of held unknowns are 0."""
    return solve(factor, jnp.eye(factor.scale.shape[0]))
