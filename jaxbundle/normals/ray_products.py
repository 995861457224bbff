"""Products of the normal equations of the rays with vectors; no row is formed, nothing is stored.

    [ U    W ]        U = A^T P A,   W = A^T P B,   V = B^T P B        A by the image, B by the point
    [ W^T  V ]

A product is a derivative of the gradient A^T P v along a vector; A^T is held for the normal equations, and moves along
for all second derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import ImagePoint
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.normals.cells import Chunk, Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.point_blocks import PointFactor, backward, forward
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.substitute import split_values

Image = tuple[Rotation, Vector, tuple[Scalar, ...]]
Gradient = Callable[[Image, Vector], tuple[Image, Vector]]


class _Rays(NamedTuple):
    """A chunk with the gradient of v^T P v / 2 of its rays; `along`: a direction of the images, where there is one."""

    chunk: Chunk
    image: Image
    along: Image
    point: Vector
    gradient: Gradient


def _rays(
    o: Observations,
    part: Tiles,
    c: Array,
    table: Float[Array, "image number"],
    width: int,
    points: Float[Array, "3 tile column"],
    exact: bool,
) -> _Rays:
    """Chunk number `c`. `table`: `width` numbers of `image_values`, and behind them, if any, those of a direction."""
    chunk = chunk_of(part, c)
    numbers = at_slots(table, chunk.slot_image)
    image = split_values(numbers[:width])
    point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, image[0], image[1])

    def equation(image: Image, point: Vector) -> ImagePoint:
        rotation, centre, interior = image
        return image_equation(o.model, rotation, centre, interior, point, chunk.measured, chunk.zero)

    held = jax.vjp(equation, image, point)[1]

    def gradient(image: Image, point: Vector) -> tuple[Image, Vector]:
        """By image, summed over the columns, and by point."""
        v, transposed = jax.vjp(equation, image, point)
        left = tuple(w * w * r for w, r in zip(chunk.weights, v, strict=True))
        return transposed(left) if exact else held(left)

    along = split_values(numbers[width:]) if len(numbers) > width else image
    return _Rays(chunk, image, along, point, gradient)


def _moved(rays: _Rays, direction: list[Array]) -> Vector:
    """A direction of the tiles' points at the cells."""
    x, y, z = (jnp.where(rays.chunk.used, d, 0.0) for d in direction)
    return x, y, z


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
        rays = _rays(o, part, c, values, values.shape[1], points, exact)
        tile = rays.chunk.first_tile + rays.chunk.tile
        moved = _moved(rays, [jnp.take(x, tile, axis=0, mode="clip") for x in u])
        _, of_image = jax.jvp(lambda point: rays.gradient(rays.image, point)[0], (rays.point,), (moved,))
        rows = jnp.concatenate(jax.tree.leaves(of_image), 1)
        return sums.at[rays.chunk.slot_image].add(rows, mode="promise_in_bounds")

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
    table = jnp.concatenate([values, direction], 1)

    def do_chunk(part: Tiles, c: Array, done: Array) -> Array:
        rays = _rays(o, part, c, table, values.shape[1], points, exact)
        _, at_points = jax.jvp(lambda image: rays.gradient(image, rays.point)[1], (rays.image,), (rays.along,))
        zero = jnp.zeros_like(rays.chunk.first_tile)
        sums = jnp.stack(sum_by_tile(list(at_points), rays.chunk))
        return lax.dynamic_update_slice(done, sums, (zero, rays.chunk.first_tile, zero))

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
    table, n = jnp.concatenate([values, direction], 1), points.shape[2]

    def add_chunk(part: Tiles, c: Array, sums: Array) -> Array:
        rays = _rays(o, part, c, table, values.shape[1], points, exact)
        chunk = rays.chunk
        _, (ut, wt) = jax.jvp(lambda image: rays.gradient(image, rays.point), (rays.image,), (rays.along,))
        stored = chunk.window(factors)
        factor = PointFactor(*(stored[:, k * n : (k + 1) * n] for k in range(6)))
        x, y, z = sum_by_tile(list(wt), chunk)
        u = backward(factor, forward(factor, (x, y, z)))
        moved = _moved(rays, [jnp.take(d, chunk.tile, axis=0, mode="clip") for d in u])
        _, wu = jax.jvp(lambda point: rays.gradient(rays.image, point)[0], (rays.point,), (moved,))
        rows = jnp.concatenate([a - b for a, b in zip(jax.tree.leaves(ut), jax.tree.leaves(wu), strict=True)], 1)
        return sums.at[chunk.slot_image].add(rows, mode="promise_in_bounds")

    sums = jnp.zeros_like(values)
    for part in tiles:
        sums = lax.fori_loop(0, part.chunks, partial(add_chunk, part), sums)
    return sums
