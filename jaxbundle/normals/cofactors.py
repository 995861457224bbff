"""Cofactors of the unknowns at the minimum: blocks of N^-1 from the factors of the elimination.

    Q_rr = (U - E E^T)^-1                                     images and border, for existing blocks
    Q_pp = L^-T (I + E^T Q_rr E) L^-1                         an eliminated point, 3 x 3

With T the tile's part of Q_rr below the diagonal and half of it on the diagonal, G = Q_rr E = (T + T^T) E: images of
a tile without a common point have no block, and need none.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.normals.chunks import BY_DEVICE, EVERYWHERE, for_chunks, over_devices
from jaxbundle.normals.eliminate import Eliminated, border_rows, coupling_rows, eliminate, eliminate_chunk
from jaxbundle.normals.inspection import INSPECTION_PARTS, Inspection, inspected
from jaxbundle.normals.leverage import (
    CellProducts,
    ReducedCofactors,
    TileCofactors,
    border_ray_leverages,
    cell_leverages,
    cell_products,
    group_leverages,
)
from jaxbundle.normals.pair_products import apply_blocks
from jaxbundle.normals.point_blocks import backward, point_equations
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, Tiles
from jaxbundle.normals.reduced_system import cofactors as reduced_cofactors, factorise
from jaxbundle.normals.step import linearise, reduced_system
from jaxbundle.numerics.devices import AXIS


class Cofactors(NamedTuple):
    """Cofactors in elimination order, 0 for fixed unknowns."""

    images: Float[Array, "image d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    inspection: Inspection
    """Inspection of the end point."""
    leverages: list[Array]
    """Leverages of all observations, in the structure of `weighted_residuals`."""


class _OfTiles(NamedTuple):
    """Result of the tiles of one device: cofactors of points and leverages of cells."""

    points: Float[Array, "3 3 tile column"]
    leverages: list[Array]


def cofactors(unknowns: OrderedUnknowns, p: Problem) -> Cofactors:
    """Cofactors of the undamped normal equations; not finite if these are singular."""
    linear = linearise(unknowns, p)
    points: Any = PartitionSpec(None, None, AXIS)
    q, found, of_tiles = over_devices(_on_device, linear, (EVERYWHERE, INSPECTION_PARTS, _OfTiles(points, BY_DEVICE)))
    leverages = list(of_tiles.leverages) + border_ray_leverages(linear, q)
    leverages += group_leverages(linear, q, of_tiles.points.reshape(3, 3, -1))
    return Cofactors(q.images, q.coupling, q.border, of_tiles.points, found, leverages)


def _on_device(linear: Linearised) -> tuple[ReducedCofactors, Inspection, _OfTiles]:
    q, found = cofactors_and_inspection(linear)
    return q, found, _of_tiles(linear, q)


def cofactors_and_inspection(linear: Linearised) -> tuple[ReducedCofactors, Inspection]:
    """Cofactors of images and border, and the inspection of the equations."""
    zero = jnp.zeros(())
    p = linear.problem
    rays, stored = eliminate(linear, zero)
    reduced = reduced_system(linear.total(rays), linear)
    factor = factorise(p.reduced, reduced.system, zero)
    found = reduced_cofactors(p.reduced, factor)
    pairs = found.pairs.at[-1].set(0.0)
    q = ReducedCofactors(pairs[p.diagonal_pair], pairs, found.coupling, found.border)
    return q, inspected(linear, reduced, factor, stored)


def _of_tiles(linear: Linearised, q: ReducedCofactors) -> _OfTiles:
    """All chunks of one device, part by part."""
    n = linear.width
    halved = halved_pairs(q, linear.problem)

    def do_chunk(part: Tiles, c: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        points, cells = carry
        e, matrix, products = cofactors_of_chunk(linear, part, c, q, halved)
        start = e.chunk.first_tile, jnp.zeros_like(e.chunk.first_tile)
        points = lax.dynamic_update_slice(points, point_cofactors(e, matrix).reshape(-1, 9 * n), start)
        return points, lax.dynamic_update_index_in_dim(cells, jnp.stack(cell_leverages(e, products)), c, 0)

    points, leverages = jnp.zeros((linear.unknowns.tiles.shape[1], 9 * n)), []
    for part in linear.problem.tiles:
        points, cells = for_chunks((part,), do_chunk, (points, jnp.zeros(part.weights.shape)))
        leverages += [cells[None, :, k] for k in range(cells.shape[1])]
    return _OfTiles(points.reshape(-1, 3, 3, n).transpose(1, 2, 0, 3), leverages)


def halved_pairs(q: ReducedCofactors, p: Problem) -> Float[Array, "pair d d"]:
    """The matrix T of each pair of images."""
    return q.pairs.at[p.diagonal_pair].multiply(0.5).at[-1].set(0.0)


def cofactors_of_chunk(
    linear: Linearised, part: Tiles, c: Array, q: ReducedCofactors, halved: Float[Array, "pair d d"]
) -> tuple[Eliminated, Float[Array, "tile 3 3 n"], list[CellProducts]]:
    """The chunk after a repeated elimination, C of its points, and Q times the rows of its cells."""
    p, n = linear.problem, linear.width
    d, inner = p.layout.image, p.layout.first_parameter
    e = eliminate_chunk(linear, part, c, jnp.zeros(()))
    coupling = coupling_rows(e, 0, d)
    g = apply_blocks(halved, part, coupling, c, e.chunk.tile_count).reshape(-1, d, 3, n)
    border_g, own_border = None, jnp.zeros(())
    if inner:
        eb = border_rows(e, p)
        at_group = jnp.take(eb, e.chunk.tile[:: part.group], axis=0, mode="clip")
        images = jnp.take(q.coupling[:, :, :inner], e.chunk.slot_image, axis=0, mode="clip")
        crossed = jnp.einsum("gab,gbk->gak", images.reshape(at_group.shape[0], -1, inner), at_group)
        g = g + crossed.reshape(-1, d, 3, n)
        by_slot = jnp.einsum("sab,sak->sbk", images, coupling.reshape(-1, d, 3 * n))
        gb = jnp.einsum("ab,tbk->tak", q.border[:inner, :inner], eb)
        gb = gb + jnp.zeros_like(gb).at[e.chunk.tile].add(by_slot)
        own_border = _contracted(eb.reshape(-1, inner, 3, n), gb.reshape(-1, inner, 3, n))
        rows = p.layout.camera_rows(p.observations.image_camera[e.chunk.slot_image])
        border_g = gb[e.chunk.tile[:, None], rows].reshape(-1, p.layout.shared, 3, n)
    by_slot = _contracted(coupling.reshape(-1, d, 3, n), g)
    m = jnp.zeros((part.max_tiles, 3, 3, n)).at[e.chunk.tile].add(by_slot) + own_border
    matrix = m + jnp.eye(3)[None, :, :, None]
    return e, matrix, cell_products(e, q, TileCofactors(g, border_g, matrix), p)


def _contracted(
    left: Float[Array, "entity row 3 n"], right: Float[Array, "entity row 3 n"]
) -> Float[Array, "entity 3 3 n"]:
    """Sums over the rows of the products of all pairs of coordinates, for each point."""
    return jnp.stack([jnp.sum(left[:, :, k, None] * right, 1) for k in range(3)], 1)


def point_cofactors(e: Eliminated, c: Float[Array, "tile 3 3 n"]) -> Float[Array, "tile 3 3 n"]:
    """The product L^-T C L^-1 for the points of a chunk."""
    f = point_equations(e.stored, c.shape[3]).factor
    half = [backward(f, (c[:, 0, j], c[:, 1, j], c[:, 2, j])) for j in range(3)]  # columns of L^-T C
    rows = [backward(f, (half[0][i], half[1][i], half[2][i])) for i in range(3)]
    return jnp.stack([jnp.stack(row, 1) for row in rows], 1)
