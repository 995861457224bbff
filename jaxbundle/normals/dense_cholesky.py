"""The reduced matrix as one dense matrix, for small blocks: A = L L^T, W = L^-1.

L^-1 r = W r,    L^-T y = W^T y,    A^-1 = W^T W
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.normals.image_factor import AbstractImageFactor
from jaxbundle.normals.inverse_factor import inverse_factor

Inverse = Float[Array, "n n"]


class DenseCholesky(AbstractImageFactor[Inverse]):
    """Dense; every device does the same. The factor is L^-1.

    `pair`: the images of a block of the pool, `images` where it has none. `image`: numbers of the images.
    """

    pair: Int[Array, "pair 2"]
    image: Int[Array, " image"]

    def factorise(self, pool: Float[Array, "pair d d"]) -> Inverse:
        images, d = self.image.shape[0], pool.shape[1]
        row, column = self.pair.T
        lower = jnp.zeros((images, d, images, d)).at[row, :, column].set(pool, mode="drop")
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
