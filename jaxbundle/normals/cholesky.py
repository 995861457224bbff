"""Dense Cholesky factorisation in plain lax, as the inverse factor of a symmetric matrix.

    A = L L^T,    W = L^-1:        L^-1 r = W r,    L^-T y = W^T y,    A^-1 = W^T W

Eliminating [A | I] by panels of s rows turns the right half into L^-1:

    C = L_kk^-1,   P = A_k C^T below the panel,   W_k <- C W_k,   W <- W - P W_k,   A <- A - P P^T

LAPACK is not used: its threads and those of XLA compete for the same cores.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.normals.problem import AbstractImageFactor

PANEL = 16


def inverse_factor(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """L^-1 of a symmetric matrix; NaN from the first row with a pivot that is not positive."""
    size = matrix.shape[0]
    if size == 0:
        return matrix
    padded = -(-size // PANEL) * PANEL
    if padded != size:
        matrix = jnp.eye(padded).at[:size, :size].set(matrix)
    row = jnp.arange(padded)[:, None]

    def panel(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        left, right = carry
        first = k * PANEL
        inverse = _small(lax.dynamic_slice(left, (first, first), (PANEL, PANEL)))
        below = jnp.where(row >= first + PANEL, lax.dynamic_slice_in_dim(left, first, PANEL, 1) @ inverse.T, 0.0)
        done = inverse @ lax.dynamic_slice_in_dim(right, first, PANEL, 0)
        # selected, not multiplied by 0: a NaN must not reach the rows above
        right = jnp.where(row >= first + PANEL, right - below @ done, right)
        return left - below @ below.T, lax.dynamic_update_slice_in_dim(right, done, first, 0)

    return lax.fori_loop(0, padded // PANEL, panel, (matrix, jnp.eye(padded)))[1][:size, :size]


def _small(matrix: Float[Array, "s s"]) -> Float[Array, "s s"]:
    """The inverse factor of one panel, row by row."""
    size = matrix.shape[0]
    row = jnp.arange(size)[:, None]

    def eliminate(j: Array, t: Array) -> Array:
        pivot_row = lax.dynamic_slice_in_dim(t, j, 1, 0)
        scale = lax.rsqrt(lax.dynamic_slice_in_dim(pivot_row, j, 1, 1))
        pivot_row = pivot_row * scale
        factor = lax.dynamic_slice_in_dim(t, j, 1, 1) * scale
        t = jnp.where(row > j, t - factor * pivot_row, t)
        return lax.dynamic_update_slice_in_dim(t, pivot_row, j, 0)

    return lax.fori_loop(0, size, eliminate, jnp.concatenate([matrix, jnp.eye(size)], 1))[:, size:]


Inverse = Float[Array, "n n"]


class DenseCholesky(AbstractImageFactor[Inverse]):
    """The dense factorisation, repeated on each device. The factor is L^-1."""

    pair: Int[Array, "pair 2"]
    """Images of each block; the number of images for unused blocks."""
    image: Int[Array, " image"]
    """Indices of the images."""

    def factorise(self, pairs: Float[Array, "pair d d"]) -> Inverse:
        images, d = self.image.shape[0], pairs.shape[1]
        row, column = self.pair.T
        lower = jnp.zeros((images, d, images, d)).at[row, :, column].set(pairs, mode="drop")
        lower = jnp.tril(lower.reshape(images * d, images * d))
        empty = jnp.ones(images).at[row].set(0.0, mode="drop")
        return inverse_factor(lower + jnp.tril(lower, -1).T + jnp.diag(jnp.repeat(empty, d)))

    def pivots(self, factor: Inverse, images: int, d: int) -> Float[Array, "image d"]:
        return (1 / jnp.diagonal(factor) ** 2).reshape(images, d)

    def forward(self, factor: Inverse, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        return (factor @ right.reshape(factor.shape[0], -1)).reshape(right.shape)

    def backward(self, factor: Inverse, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        return (factor.T @ right.reshape(factor.shape[0], -1)).reshape(right.shape)

    def selected_inverse(self, factor: Inverse, d: int) -> Float[Array, "pair d d"]:
        z = (factor.T @ factor).reshape(-1, d, factor.shape[0] // d, d)
        return z.at[self.pair[:, 0], :, self.pair[:, 1]].get(mode="fill", fill_value=0.0)
