"""Cofactors of the unknowns at the minimum: blocks of N^-1 from the factors of the elimination.

    Q_kk = (U - E E^T)^-1                                     kept unknowns, where the pool has blocks
    Q_pp = L^-T (I + E^T Q_kk E) L^-1                         an eliminated point, 3 x 3

With T the tile's part of Q_kk below the diagonal and half of it on the diagonal, G = Q_kk E = (T + T^T) E: the images
of a tile that share no point have no block in the pool, and need none.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles
from jaxbundle.normals.eliminate import Eliminated, border_rows, coupling_rows, eliminate, eliminate_chunk
from jaxbundle.normals.inspection import Inspection, inspected, inspection_parts
from jaxbundle.normals.leverage import (
    CellProducts,
    KeptCofactors,
    cell_leverages,
    cell_products,
    group_leverages,
    kept_ray_leverages,
)
from jaxbundle.normals.partition import local_tiles
from jaxbundle.normals.point_blocks import PointFactor, backward
from jaxbundle.normals.products import contracted
from jaxbundle.normals.reduced_system import cofactors as reduced_cofactors
from jaxbundle.normals.reduced_system import factorise
from jaxbundle.normals.step import Linearised, linearise, partition, reduced_system
from jaxbundle.numerics.devices import AXIS, device_mesh


class Cofactors(NamedTuple):
    """Cofactors in the order of elimination, 0 for what is held; what the equations tell of the end point; leverages of
    all observations, as `weighted_residuals` lists them."""

    images: Float[Array, "image d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    inspection: Inspection
    leverages: list[Array]


class _OfTiles(NamedTuple):
    """What the tiles of one device give: points' cofactors and leverages of the cells."""

    points: Float[Array, "3 3 tile column"]
    leverages: list[Array]


def cofactors(unknowns: Arranged, p: Problem) -> Cofactors:
    """Cofactors of the undamped normal equations; not finite where these are singular."""
    linear, free = linearise(unknowns, p), p.free_tiles
    if p.devices == 1:
        return _with_others(*_on_device(unknowns, linear, p, free, None), unknowns, linear, p)
    everywhere: Any = PartitionSpec()
    points: Any = PartitionSpec(None, None, AXIS)
    of_tiles: Any = PartitionSpec(AXIS)
    out = everywhere, inspection_parts(), _OfTiles(points, of_tiles)
    unknown_parts, linear_parts, problem_parts = partition(unknowns, linear, p)
    parts = jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(unknown_parts, linear_parts, problem_parts, PartitionSpec(None, AXIS)),
        out_specs=out,
        check_vma=False,
    )(unknowns, linear, p, free)
    return _with_others(*parts, unknowns, linear, p)


def _on_device(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None
) -> tuple[KeptCofactors, Inspection, _OfTiles]:
    tiles = local_tiles(p.tiles)
    q, found = kept_cofactors(unknowns, linear, p, free, tiles, axis)
    return q, found, _of_tiles(unknowns, linear, p, free, tiles, q)


def kept_cofactors(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, tiles: tuple[Tiles, ...], axis: str | None
) -> tuple[KeptCofactors, Inspection]:
    """Cofactors of the kept unknowns, and what the equations tell."""
    zero = jnp.zeros(())
    rays, factors = eliminate(
        p.observations, linear.table, unknowns.tiles, linear.prior, free, zero, tiles, p.shape, p.diagonal_pair
    )
    reduced = reduced_system(lax.psum(rays, axis) if axis else rays, linear.kept, p)
    factor = factorise(p.reduced, reduced.system, zero)
    found = reduced_cofactors(p.reduced, factor)
    pool = found.pool.at[-1].set(0.0)
    q = KeptCofactors(pool[p.diagonal_pair], pool, found.coupling, found.border)
    return q, inspected(reduced, factor, factors, unknowns, axis)


def _with_others(
    q: KeptCofactors,
    inspection: Inspection,
    found: _OfTiles,
    unknowns: Arranged,
    linear: Linearised,
    p: Problem,
) -> Cofactors:
    """The result, with the leverages of observations that are no rays of eliminated points."""
    o, shape, leverages = p.observations, p.shape, list(found.leverages)
    leverages += kept_ray_leverages(p.kept_rays, unknowns.images, linear.turns, o, shape, q)
    flat = unknowns.flat() if o.groups else unknowns.images
    points = found.points.reshape(3, 3, -1)
    leverages += [
        group_leverages(group, pairs, flat, linear.turns, o, shape, p.point_column, p.camera_image, q, points)
        for group, pairs in zip(o.groups, p.group_pairs, strict=True)
    ]
    return Cofactors(q.images, q.coupling, q.border, found.points, inspection, leverages)


def _of_tiles(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, tiles: tuple[Tiles, ...], q: KeptCofactors
) -> _OfTiles:
    """All chunks of one device, part by part."""
    n = unknowns.tiles.shape[2]
    halved = halved_pool(q, p)

    def do_chunk(part: Tiles, c: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        store, cells = carry
        rows, leverages = _of_chunk(unknowns, linear, p, free, part, q, halved, c)
        store = lax.dynamic_update_slice(store, rows[0], (rows[1], jnp.zeros_like(rows[1])))
        return store, lax.dynamic_update_index_in_dim(cells, leverages, c, 0)

    store, leverages = jnp.zeros((unknowns.tiles.shape[1], 9 * n)), []
    for part in tiles:
        cells = jnp.zeros(part.weights.shape)
        store, cells = lax.fori_loop(0, part.chunks, partial(do_chunk, part), (store, cells))
        leverages += [cells[None, :, 0], cells[None, :, 1]]
    return _OfTiles(store.reshape(-1, 3, 3, n).transpose(1, 2, 0, 3), leverages)


def halved_pool(q: KeptCofactors, p: Problem) -> Float[Array, "pair d d"]:
    """T of every pair of images."""
    return q.pool.at[p.diagonal_pair].multiply(0.5).at[-1].set(0.0)


def _of_chunk(
    unknowns: Arranged,
    linear: Linearised,
    p: Problem,
    free: Array,
    part: Tiles,
    q: KeptCofactors,
    halved: Float[Array, "pair d d"],
    c: Array,
) -> tuple[tuple[Array, Array], Float[Array, "2 slot n"]]:
    """Rows of the chunk's points and where they begin; leverages of its cells."""
    e, matrix, products = cofactors_of_chunk(unknowns, linear, p, free, part, q, halved, c)
    rows = point_blocks(e, matrix).reshape(-1, 9 * unknowns.tiles.shape[2])
    return (rows, e.chunk.first_tile), jnp.stack(cell_leverages(e, products))


def cofactors_of_chunk(
    unknowns: Arranged,
    linear: Linearised,
    p: Problem,
    free: Array,
    part: Tiles,
    q: KeptCofactors,
    halved: Float[Array, "pair d d"],
    c: Array,
) -> tuple[Eliminated, Float[Array, "tile 3 3 n"], tuple[CellProducts, CellProducts]]:
    """The chunk eliminated again, C of its points, and Q times the rows of its cells."""
    assert part.products is not None
    o, shape, n = p.observations, p.shape, unknowns.tiles.shape[2]
    d, inner = shape.image, shape.first_parameter
    e = eliminate_chunk(o, linear.table, unknowns.tiles, linear.prior, free, jnp.zeros(()), part, c)
    coupling = coupling_rows(e, 0, d)
    g = part.products.applied(halved, coupling, c, e.chunk.tile_count).reshape(-1, d, 3, n)
    border_g, own_border = None, jnp.zeros(())
    if inner:
        eb = border_rows(e, o, shape)
        at_group = jnp.take(eb, e.chunk.tile[:: part.group], axis=0, mode="clip")
        images = jnp.take(q.coupling[:, :, :inner], e.chunk.slot_image, axis=0, mode="clip")
        crossed = jnp.einsum("gab,gbk->gak", images.reshape(at_group.shape[0], -1, inner), at_group)
        g = g + crossed.reshape(-1, d, 3, n)
        by_slot = jnp.einsum("sab,sak->sbk", images, coupling.reshape(-1, d, 3 * n))
        gb = jnp.einsum("ab,tbk->tak", q.border[:inner, :inner], eb)
        gb = gb + jnp.zeros_like(gb).at[e.chunk.tile].add(by_slot)
        own_border = contracted(eb.reshape(-1, inner, 3, n), gb.reshape(-1, inner, 3, n))
        columns = shape.shared * o.image_camera[e.chunk.slot_image][:, None] + jnp.arange(shape.shared)
        border_g = gb[e.chunk.tile[:, None], columns].reshape(-1, shape.shared, 3, n)
    by_slot = contracted(coupling.reshape(-1, d, 3, n), g)
    m = jnp.zeros((part.most_tiles, 3, 3, n)).at[e.chunk.tile].add(by_slot) + own_border
    matrix = m + jnp.eye(3)[:, :, None]
    return e, matrix, cell_products(e, q, g, border_g, matrix, o.image_camera, shape)


def point_blocks(e: Eliminated, c: Float[Array, "tile 3 3 n"]) -> Float[Array, "tile 3 3 n"]:
    """L^-T C L^-1 of the points of a chunk."""
    n = c.shape[3]
    f = PointFactor(*(e.factor[:, k * n : (k + 1) * n] for k in range(6)))
    half = [backward(f, (c[:, 0, j], c[:, 1, j], c[:, 2, j])) for j in range(3)]  # columns of L^-T C
    rows = [backward(f, (half[0][i], half[1][i], half[2][i])) for i in range(3)]
    return jnp.stack([jnp.stack(row, 1) for row in rows], 1)
