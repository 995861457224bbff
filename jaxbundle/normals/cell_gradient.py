"""The rays of the tiles in the transposed derivative of cofactors and leverages (`cofactor_gradient`)."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import Measured
from jaxbundle.normals.chunks import Chunk, at_slots, chunk_of, for_chunks, image_scalars, points_at_cells, sum_by_tile
from jaxbundle.normals.cofactors import cofactors_and_inspection, cofactors_of_chunk, halved_pairs, point_cofactors
from jaxbundle.normals.eliminate import Eliminated
from jaxbundle.normals.leverage import CellProducts, ReducedCofactors
from jaxbundle.normals.point_blocks import backward, point_equations
from jaxbundle.normals.problem import Linearised, ReducedSums, Tiles
from jaxbundle.normals.rows import Image, image_equation
from jaxbundle.numerics.linear_map import directional

Rows = list[Any]
Cells = list[Float[Array, "1 chunk number slot column"]]


class Varied(NamedTuple):
    """Derivatives of the linearised equations with respect to t; all other parts are constant."""

    sums: ReducedSums
    point_terms: Float[Array, "9 tile column"]
    weights: Cells

    def along(self, linear: Linearised) -> Linearised:
        """The change as a direction of the equations of one device; None for constant parts."""
        nothing = jax.tree.map(lambda _: None, linear)

        def varied(linear: Linearised) -> list[Any]:
            return [linear.sums, linear.point_terms, *(t.weights for t in linear.problem.tiles)]

        change = [self.sums, self.point_terms, *(w[0] for w in self.weights)]
        return eqx.tree_at(varied, nothing, change, is_leaf=lambda x: x is None)


class GradientOfTiles(NamedTuple):
    """Result of the tiles of one device."""

    reduced: tuple[ReducedCofactors, ReducedCofactors]
    """Q and Q' of images and border."""
    points: tuple[Float[Array, "tile number"], Float[Array, "tile number"]]
    """Q and Q' of the points."""
    table: Float[Array, "image number"]
    """Gradient of phi with respect to the table of the images."""
    tiles: Float[Array, "3 tile column"]
    """Gradient of phi with respect to the points."""
    measured: Cells
    weights: Cells


def gradient_of_tiles(
    linear: Linearised, varied: Varied, k: list[Float[Array, "1 chunk slot column"]]
) -> GradientOfTiles:
    """The gradient of one device; `k`: weights of the leverages of the cells, per component and part."""
    along, components = varied.along(linear), linear.problem.observations.model.components
    reduced = directional(lambda linear: cofactors_and_inspection(linear)[0], (linear,), (along,))
    halved = [halved_pairs(q, linear.problem) for q in reduced]
    at, change = (linear, reduced[0], halved[0]), (along, reduced[1], halved[1])
    blocks = jnp.zeros((linear.unknowns.tiles.shape[1], 9 * linear.width))
    shared = (blocks, blocks), jnp.zeros_like(linear.table), jnp.zeros_like(linear.unknowns.tiles)
    measured, weights = [], []
    for i, part in enumerate(linear.problem.tiles):
        factors = [x[0] for x in k[components * i : components * (i + 1)]]

        def add_chunk(_: Tiles, c: Array, done: Any, i: int = i, factors: list[Array] = factors) -> Any:
            return _add_chunk((at, change), i, factors, c, done)

        start = shared, jnp.zeros_like(part.measured), jnp.zeros_like(part.weights)
        shared, of_measured, of_weights = for_chunks((part,), add_chunk, start)
        measured.append(of_measured[None])
        weights.append(of_weights[None])
    points, table, tiles = shared
    return GradientOfTiles(reduced, points, linear.total(table), tiles, measured, weights)


def _add_chunk(given: tuple[tuple, tuple], i: int, k: list[Array], c: Array, done: Any) -> Any:
    """Adds chunk `c` of part `i`. `given`: equations, Q and T, and their derivatives with respect to t."""
    at, change = given
    ((points, points_along), table, tiles), measured, weights = done
    linear: Linearised = at[0]

    def products(linear: Linearised, q: ReducedCofactors, halved: Array) -> tuple[list[Rows], Array]:
        e, matrix, rows = cofactors_of_chunk(linear, linear.problem.tiles[i], c, q, halved)
        return [_by_unknowns(e, row) for row in rows], point_cofactors(e, matrix).reshape(e.stored.shape[0], -1)

    (rows, blocks), (rows_along, blocks_along) = directional(products, at, change)
    chunk = chunk_of(linear.problem.tiles[i], c)
    directions = []
    for factor, row, row_along in zip(k, rows, rows_along, strict=True):
        # phi has 2 y da; the row times the root of 1 + t k changes by k / 2, so the other half is added here
        own = lax.dynamic_index_in_dim(factor, c, 0, False)
        directions.append([own * a + 2 * b for a, b in zip(row, row_along, strict=True)])
    by_numbers, by_points, by_measured, by_weights = _row_gradient(linear, chunk, directions)
    zero = jnp.zeros_like(chunk.first_tile)
    store = lambda x, rows: lax.dynamic_update_slice(x, rows, (chunk.first_tile, zero))  # noqa: E731
    of_points = jnp.stack(sum_by_tile(by_points, chunk))
    return (
        (
            (store(points, blocks), store(points_along, blocks_along)),
            table.at[chunk.slot_image].add(jnp.concatenate(by_numbers, 1), mode="promise_in_bounds"),
            lax.dynamic_update_slice(tiles, of_points, (zero, chunk.first_tile, zero)),
        ),
        lax.dynamic_update_index_in_dim(measured, jnp.stack(by_measured), c, 0),
        lax.dynamic_update_index_in_dim(weights, jnp.stack(by_weights), c, 0),
    )


def _by_unknowns(e: Eliminated, q: CellProducts) -> Rows:
    """Q times a row, for the unknowns of the image, of its camera, and for X, Y, Z."""
    factor = point_equations(e.chunk.at_slots(e.stored), e.chunk.used.shape[1]).factor
    x, y, z = q.point
    return [*q.image, *q.camera, *backward(factor, (x, y, z))]


def _row_gradient(linear: Linearised, chunk: Chunk, directions: list[Rows]) -> tuple[Rows, Rows, Rows, Rows]:
    """Gradient of the sum of the rows, each times a direction.

    It has parts with respect to the numbers of the images at the slots, and to points, measured numbers and weights at
    the cells.
    """
    o, shape = linear.problem.observations, chunk.used.shape
    numbers = at_slots(linear.table, chunk.slot_image)
    image, tile = image_scalars(numbers), chunk.first_tile + chunk.tile
    point = points_at_cells(chunk, list(linear.unknowns.tiles), tile, image.rotation, image.centre)

    def along(numbers: Rows, point: Vector, measured: Measured, d: Rows) -> tuple[Array, ...]:
        image = image_scalars([jnp.broadcast_to(x, shape) for x in numbers])
        turned = [sum(t[i] * a for t, a in zip(image.rotation_derivatives, d[3:6], strict=True)) for i in range(9)]
        interior = [jnp.zeros(shape)] * len(image.interior)
        for column, x in zip(o.columns, d[6:-3], strict=True):
            interior[column] = x

        def equation(image: Image, point: Vector) -> Any:
            return image_equation(o.model, image, point, measured, chunk.zero)

        there = (image.rotation, image.centre, image.interior), point
        return jax.jvp(equation, there, ((tuple(turned), tuple(d[:3]), tuple(interior)), tuple(d[-3:])))[1]

    def product(numbers: Rows, point: Vector, measured: Measured, weights: tuple[Array, ...]) -> Array:
        rows = (along(numbers, point, measured, d)[i] * weights[i] for i, d in enumerate(directions))
        return sum((jnp.sum(row) for row in rows), jnp.zeros(()))

    gradient = jax.grad(product, (0, 1, 2, 3))(numbers, point, chunk.measured, chunk.weights)
    by_numbers, by_points, by_measured, by_weights = (list(part) for part in gradient)
    return by_numbers, by_points, by_measured, by_weights
