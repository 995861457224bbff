"""Products of the normal equations of the rays with vectors; no row is formed, nothing is stored.

    [ U    W ]        U = A^T P A,   W = A^T P B,   V = B^T P B        A by the image, B by the point
    [ W^T  V ]

A product is a derivative of the gradient A^T P v along a vector; A^T is held for the normal equations, and moves along
for all second derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import ImagePoint
from jaxbundle.normals.cells import Chunk, Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.substitute import split_values

Gradient = Callable[[Any, Vector], tuple[Any, Vector]]


def _gradient(o: Observations, chunk: Chunk, image: Any, point: Vector, exact: bool) -> Gradient:
    """Gradient of v^T P v / 2 by image, summed over the columns, and point."""

    def equation(image: Any, point: Vector) -> ImagePoint:
        rotation, centre, interior = image
        return image_equation(o.model, rotation, centre, interior, point, chunk.measured, chunk.zero)

    held = jax.vjp(equation, image, point)[1]

    def gradient(image: Any, point: Vector) -> tuple[Any, Vector]:
        v, transposed = jax.vjp(equation, image, point)
        left = tuple(w * w * r for w, r in zip(chunk.weights, v, strict=True))
        return transposed(left) if exact else held(left)

    return gradient


def to_images(
    o: Observations,
    values: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    u: Float[Array, "3 tile column"],
    tiles: tuple[Tiles, ...],
    exact: bool,
) -> Float[Array, "image number"]:
    """W u of the rays of one device, by the numbers of `image_values`."""

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        chunk = chunk_of(part, c)
        image = split_values(at_slots(values, chunk.slot_image))
        tile = chunk.first_tile + chunk.tile
        point = points_at_cells(chunk, list(points), tile, image[0], image[1])
        moved = (jnp.take(coordinate, tile, axis=0, mode="clip") for coordinate in u)
        x, y, z = (jnp.where(chunk.used, m, 0.0) for m in moved)
        gradient = _gradient(o, chunk, image, point, exact)
        _, of_image = jax.jvp(lambda point: gradient(image, point)[0], (point,), ((x, y, z),))
        rows = jnp.concatenate(jax.tree.leaves(of_image), 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    sums = jnp.zeros_like(values)
    for part in tiles:
        sums = lax.fori_loop(0, part.chunks, partial(add_chunk, part), sums)
    return sums


def to_points(
    o: Observations,
    values: Float[Array, "image number"],
    direction: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    tiles: tuple[Tiles, ...],
    exact: bool,
) -> Float[Array, "3 tile column"]:
    """W^T t of the rays of one device; `direction` is t, by the numbers of `image_values`."""
    table, width = jnp.concatenate([values, direction], 1), values.shape[1]

    def do_chunk(part: Tiles, c: Array, done: Array) -> Array:
        chunk = chunk_of(part, c)
        numbers = at_slots(table, chunk.slot_image)
        image, along = split_values(numbers[:width]), split_values(numbers[width:])
        point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, image[0], image[1])
        gradient = _gradient(o, chunk, image, point, exact)
        _, at_points = jax.jvp(lambda image: gradient(image, point)[1], (image,), (along,))
        zero = jnp.zeros_like(chunk.first_tile)
        sums = jnp.stack(sum_by_tile(list(at_points), chunk))
        return lax.dynamic_update_slice(done, sums, (zero, chunk.first_tile, zero))

    done = jnp.zeros_like(points)
    for part in tiles:
        done = lax.fori_loop(0, part.chunks, partial(do_chunk, part), done)
    return done


def reduced_product(
    o: Observations,
    values: Float[Array, "image number"],
    direction: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    factors: Float[Array, "tile numbers"],
    tiles: tuple[Tiles, ...],
    exact: bool,
) -> Float[Array, "image number"]:
    """U t - W V^-1 W^T t of the rays of one device, by the numbers of `image_values`; `direction` is t."""
    table = jnp.concatenate([values, direction], 1)
    width, n = values.shape[1], points.shape[2]

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        chunk = chunk_of(part, c)
        numbers = at_slots(table, chunk.slot_image)
        image, along = split_values(numbers[:width]), split_values(numbers[width:])
        point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, image[0], image[1])
        gradient = _gradient(o, chunk, image, point, exact)
        _, (ut, wt) = jax.jvp(lambda image: gradient(image, point), (image,), (along,))
        stored = chunk.window(factors)
        factor = PointFactor(*(stored[:, k * n : (k + 1) * n] for k in range(6)))
        own = (jnp.arange(chunk.most_tiles) < chunk.tile_count)[:, None]
        x, y, z = sum_by_tile(list(wt), chunk)
        u = [jnp.where(own, c, 0.0) for c in backward(factor, forward(factor, (x, y, z)))]
        ux, uy, uz = (jnp.take(c, chunk.tile, axis=0, mode="clip") for c in u)
        _, wu = jax.jvp(lambda point: gradient(image, point)[0], (point,), ((ux, uy, uz),))
        rows = jnp.concatenate([a - b for a, b in zip(jax.tree.leaves(ut), jax.tree.leaves(wu), strict=True)], 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    sums = jnp.zeros_like(values)
    for part in tiles:
        sums = lax.fori_loop(0, part.chunks, partial(add_chunk, part), sums)
    return sums
