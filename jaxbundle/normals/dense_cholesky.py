"""Cholesky factorisation of the reduced matrix as one dense matrix, for small blocks: A = L L^T, A^-1 = L^-T L^-1."""

import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from jaxbundle.normals.image_factor import AbstractImageFactor

Lower = Float[Array, "n n"]


class DenseCholesky(AbstractImageFactor[Lower]):
    """Dense; every device does the same. `pair`: the images of a block of the pool, `images` where it has none."""

    pair: Int[Array, "pair 2"]
    image: Int[Array, " image"]

    def factorise(self, pool: Float[Array, "pair d d"]) -> Lower:
        images, d = self.image.shape[0], pool.shape[1]
        row, column = self.pair.T
        matrix = jnp.zeros((images, d, images, d)).at[row, :, column].set(pool, mode="drop")
        empty = jnp.ones(images).at[row].set(0.0, mode="drop")
        matrix = matrix.reshape(images * d, images * d) + jnp.diag(jnp.repeat(empty, d))
        return jnp.linalg.cholesky(matrix, symmetrize_input=False)

    def pivots(self, factor: Lower, images: int, d: int) -> Float[Array, "image d"]:
        return (jnp.diagonal(factor) ** 2).reshape(images, d)

    def forward(self, factor: Lower, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        flat = right.reshape(factor.shape[0], -1)
        return solve_triangular(factor, flat, lower=True).reshape(right.shape)

    def backward(self, factor: Lower, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        flat = right.reshape(factor.shape[0], -1)
        return solve_triangular(factor, flat, lower=True, trans="T").reshape(right.shape)

    def selected_inverse(self, factor: Lower, d: int) -> Float[Array, "pair d d"]:
        inverse = solve_triangular(factor, jnp.eye(factor.shape[0]), lower=True)
        z = (inverse.T @ inverse).reshape(-1, d, factor.shape[0] // d, d)
        return z.at[self.pair[:, 0], :, self.pair[:, 1]].get(mode="fill", fill_value=0.0)
