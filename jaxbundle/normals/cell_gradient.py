"""The rays of the tiles in the transposed derivative of cofactors and leverages (`cofactor_gradient`)."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxbundle.block.residuals import Observations
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import ImagePoint
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Chunk, Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.cofactors import cofactors_of_chunk, halved_pool, kept_cofactors, point_blocks
from jaxbundle.normals.eliminate import Eliminated, image_scalars
from jaxbundle.normals.leverage import CellProducts, KeptCofactors
from jaxbundle.normals.partition import local_tiles
from jaxbundle.normals.point_blocks import PointFactor, backward
from jaxbundle.normals.rows import image_equation
from jaxbundle.normals.step import Linearised
from jaxbundle.numerics.linear_map import directional

Rows = list[Any]


class OfTiles(NamedTuple):
    """What the tiles of one device give: Q and Q' of the kept unknowns and of the points; gradients of phi by the table
    of the images, the points, measured coordinates and weights."""

    kept: tuple[KeptCofactors, KeptCofactors]
    points: tuple[Float[Array, "tile number"], Float[Array, "tile number"]]
    table: Float[Array, "image number"]
    tiles: Float[Array, "3 tile column"]
    measured: list[Float[Array, "1 chunk 2 slot column"]]
    weights: list[Float[Array, "1 chunk 2 slot column"]]


class _Given(NamedTuple):
    """What Q of the rows of a part is computed from, and moves along t."""

    weights: Float[Array, "chunk 2 slot column"]
    prior: Float[Array, "9 tile column"] | None
    kept: KeptCofactors
    halved: Float[Array, "pair d d"]


def gradient_of_tiles(
    unknowns: Arranged,
    linear: tuple[Linearised, Linearised],
    p: Problem,
    weights_moved: list[Float[Array, "1 chunk 2 slot column"]],
    k: list[Float[Array, "1 chunk slot column"]],
    free: Bool[Array, "3 tile column"],
    axis: str | None,
) -> OfTiles:
    """Of one device. `linear`: the equations and how they move with t; `k`: weights of the leverages, x, y by turns."""

    def of_kept(linear: Linearised, weights: list[Array]) -> KeptCofactors:
        tiles = tuple(dataclasses.replace(t, weights=w) for t, w in zip(p.tiles, weights, strict=True))
        moved = dataclasses.replace(p, tiles=tiles)
        return kept_cofactors(unknowns, linear, moved, free, local_tiles(moved.tiles), axis)[0]

    here, along = linear
    kept = directional(of_kept, (here, [t.weights for t in p.tiles]), (along, weights_moved))
    halved = [halved_pool(q, p) for q in kept]
    blocks = jnp.zeros((unknowns.tiles.shape[1], 9 * unknowns.tiles.shape[2]))
    shared = (blocks, blocks), jnp.zeros_like(here.table), jnp.zeros_like(unknowns.tiles)
    own = []
    for i, part in enumerate(local_tiles(p.tiles)):
        at = _Given(part.weights, here.prior, kept[0], halved[0])
        moved = _Given(weights_moved[i][0], along.prior, kept[1], halved[1])
        factors = k[2 * i][0], k[2 * i + 1][0]
        do_chunk = partial(_add_chunk, unknowns, here, p, free, part, at, moved, factors)
        start = *shared, jnp.zeros_like(part.measured), jnp.zeros_like(part.weights)
        *shared, measured, weights = lax.fori_loop(0, part.chunks, do_chunk, start)
        own.append((measured[None], weights[None]))
    points, table, tiles = shared
    if axis:
        table = lax.psum(table, axis)
    return OfTiles(kept, points, table, tiles, [m for m, _ in own], [w for _, w in own])


def _add_chunk(
    unknowns: Arranged,
    linear: Linearised,
    p: Problem,
    free: Array,
    part: Tiles,
    at: _Given,
    moved: _Given,
    k: tuple[Array, Array],
    c: Array,
    done: tuple,
) -> tuple:
    points, table, tiles, measured, weights = done

    def products(given: _Given) -> tuple[tuple[Rows, Rows], Array]:
        own = dataclasses.replace(part, weights=given.weights)
        linear_there = linear._replace(prior=given.prior)
        e, matrix, (x, y) = cofactors_of_chunk(unknowns, linear_there, p, free, own, given.kept, given.halved, c)
        return (_by_unknowns(e, x), _by_unknowns(e, y)), point_blocks(e, matrix).reshape(e.factor.shape[0], -1)

    (q_rows, blocks), (q_moved, blocks_moved) = directional(products, (at,), (moved,))
    chunk = chunk_of(part, c)
    directions = []
    for factor, row, row_moved in zip(k, q_rows, q_moved, strict=True):
        # phi has 2 y da; the row times the root of 1 + t k has moved by k / 2, so the other half comes here
        own = lax.dynamic_index_in_dim(factor, c, 0, False)
        directions.append([own * a + 2 * b for a, b in zip(row, row_moved, strict=True)])
    by_numbers, by_points, by_measured, by_weights = _row_gradient(
        p.observations, linear.table, unknowns.tiles, chunk, directions
    )
    zero = jnp.zeros_like(chunk.first_tile)
    store = lambda x, rows: lax.dynamic_update_slice(x, rows, (chunk.first_tile, zero))  # noqa: E731
    return (
        (store(points[0], blocks), store(points[1], blocks_moved)),
        table.at[chunk.slot_image].add(jnp.concatenate(by_numbers, 1), mode="promise_in_bounds"),
        lax.dynamic_update_slice(tiles, jnp.stack(sum_by_tile(by_points, chunk)), (zero, chunk.first_tile, zero)),
        lax.dynamic_update_index_in_dim(measured, jnp.stack(by_measured), c, 0),
        lax.dynamic_update_index_in_dim(weights, jnp.stack(by_weights), c, 0),
    )


def _by_unknowns(e: Eliminated, q: CellProducts) -> Rows:
    """Q of a row by the unknowns of the image, of its camera, and by X, Y, Z."""
    at_slot = jnp.take(e.factor, e.chunk.tile, axis=0, mode="clip")
    n = e.chunk.used.shape[1]
    factor = PointFactor(*(at_slot[:, i * n : (i + 1) * n] for i in range(6)))
    x, y, z = q.point
    return [*q.image, *q.camera, *backward(factor, (x, y, z))]


def _row_gradient(
    o: Observations,
    table: Float[Array, "image number"],
    points: Float[Array, "3 tile column"],
    chunk: Chunk,
    directions: list[Rows],
) -> tuple[Rows, Rows, Rows, Rows]:
    """Gradient of the sum of the rows times a direction each: by the numbers of the image at the slots, by the points,
    the measured coordinates and the weights at the cells."""
    numbers, shape = at_slots(table, chunk.slot_image), chunk.used.shape
    rotation, centre = numbers[:9], numbers[36:39]
    tile = chunk.first_tile + chunk.tile
    point = points_at_cells(chunk, list(points), tile, tuple(rotation), (centre[0], centre[1], centre[2]))

    def along(numbers: Rows, point: Vector, measured: ImagePoint, d: Rows) -> ImagePoint:
        image = image_scalars([jnp.broadcast_to(x, shape) for x in numbers])
        turned = [sum(t[i] * a for t, a in zip(image.rotation_derivatives, d[3:6], strict=True)) for i in range(9)]
        interior = [jnp.zeros(shape)] * len(image.interior)
        for column, x in zip(o.columns, d[6:-3], strict=True):
            interior[column] = x

        def equation(rotation: Any, centre: Any, interior: Any, point: Vector) -> ImagePoint:
            return image_equation(o.model, rotation, centre, interior, point, measured, chunk.zero)

        there = image.rotation, image.centre, image.interior, point
        return jax.jvp(equation, there, (tuple(turned), tuple(d[:3]), tuple(interior), tuple(d[-3:])))[1]

    def product(numbers: Rows, point: Vector, measured: ImagePoint, weights: ImagePoint) -> Array:
        rows = (along(numbers, point, measured, d)[i] * weights[i] for i, d in enumerate(directions))
        return sum((jnp.sum(row) for row in rows), jnp.zeros(()))

    gradient = jax.grad(product, (0, 1, 2, 3))(numbers, point, chunk.measured, chunk.weights)
    by_numbers, by_points, by_measured, by_weights = (list(part) for part in gradient)
    return by_numbers, by_points, by_measured, by_weights
