"""Products of the normal equations of the rays with vectors, without forming or storing rows.

    [ U    W ]        U = A^T P A,   W = A^T P B,   V = B^T P B        A for the image, B for the point
    [ W^T  V ]

A product is a derivative of the gradient A^T P v along a vector; A^T is constant for the normal equations, and variable
for all second derivatives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.camera.collinearity import Vector
from jaxbundle.normals.chunks import (
    ChunkRays,
    chunk_rays,
    for_chunks,
    in_tiles,
    split_values,
    sum_by_tile,
)
from jaxbundle.normals.point_blocks import backward, forward, point_equations
from jaxbundle.normals.problem import Linearised, Tiles
from jaxbundle.normals.rows import Image


class _Gradient(NamedTuple):
    """The gradient of v^T P v / 2 of the rays of a chunk; `along`: a direction of the images, if any."""

    rays: ChunkRays
    along: Image
    exact: bool

    def __call__(self, image: Image, point: Vector) -> tuple[Image, Vector]:
        """The gradient for images, summed over the columns, and for points."""
        v, transposed = jax.vjp(self.rays.equation, image, point)
        left = tuple(w * w * r for w, r in zip(self.rays.chunk.weights, v, strict=True))
        if self.exact:
            return transposed(left)
        return jax.vjp(self.rays.equation, self.rays.image, self.rays.point)[1](left)

    def along_images(self) -> tuple[Image, Vector]:
        """Derivative along the direction of the images."""
        return jax.jvp(lambda image: self(image, self.rays.point), (self.rays.image,), (self.along,))[1]

    def along_points(self, direction: list[Array]) -> list[Array]:
        """Derivative of the part of the images along a direction of the points at the cells."""
        x, y, z = (jnp.where(self.rays.chunk.used, d, 0.0) for d in direction)
        _, of_image = jax.jvp(lambda point: self(self.rays.image, point)[0], (self.rays.point,), ((x, y, z),))
        return jax.tree.leaves(of_image)


def _gradient(linear: Linearised, part: Tiles, c: Array, table: Float[Array, "image number"]) -> _Gradient:
    """The chunk `c`; `table`: values of the images, followed by those of a direction, if any."""
    rays = chunk_rays(linear, part, c, table)
    behind = rays.numbers[linear.values.shape[1] :]
    return _Gradient(rays, split_values(behind) if behind else rays.image, linear.exact)


def to_images(linear: Linearised, u: Float[Array, "3 tile column"]) -> Float[Array, "image number"]:
    """The product W u of the rays of one device, with respect to the values of the images."""
    values = linear.values

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        gradient = _gradient(linear, part, c, values)
        chunk = gradient.rays.chunk
        tile = chunk.first_tile + chunk.tile
        rows = gradient.along_points([jnp.take(x, tile, axis=0, mode="clip") for x in u])
        return sums.at[chunk.slot_image].add(jnp.concatenate(rows, 1), mode="promise_in_bounds")

    return for_chunks(linear.problem.tiles, add_chunk, jnp.zeros_like(values))


def to_points(linear: Linearised, direction: Float[Array, "image number"]) -> Float[Array, "3 tile column"]:
    """The product W^T t of the rays of one device; `direction` is t in terms of the values of the images."""
    table = jnp.concatenate([linear.values, direction], 1)

    def do_chunk(part: Tiles, c: Array, done: Array) -> Array:
        gradient = _gradient(linear, part, c, table)
        _, at_points = gradient.along_images()
        return in_tiles(sum_by_tile(list(at_points), gradient.rays.chunk), gradient.rays.chunk, done)

    return for_chunks(linear.problem.tiles, do_chunk, jnp.zeros_like(linear.unknowns.tiles))


def reduced_product(
    linear: Linearised, direction: Float[Array, "image number"], stored: Float[Array, "tile value"]
) -> Float[Array, "image number"]:
    """The product U t - W V^-1 W^T t of the rays of one device, for the values of the images.

    `direction` is t.
    """
    table = jnp.concatenate([linear.values, direction], 1)

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        gradient = _gradient(linear, part, c, table)
        chunk = gradient.rays.chunk
        ut, wt = gradient.along_images()
        factor = point_equations(chunk.window(stored), linear.width).factor
        x, y, z = sum_by_tile(list(wt), chunk)
        u = backward(factor, forward(factor, (x, y, z)))
        wu = gradient.along_points([chunk.at_slots(d) for d in u])
        rows = jnp.concatenate([a - b for a, b in zip(jax.tree.leaves(ut), wu, strict=True)], 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    return for_chunks(linear.problem.tiles, add_chunk, jnp.zeros_like(linear.values))
