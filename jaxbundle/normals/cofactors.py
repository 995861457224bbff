"""Cofactors of the unknowns at the minimum: blocks of N^-1 from the factors of the elimination.

    Q_kk = (U - E E^T)^-1                                     kept unknowns, where the pool has blocks
    Q_pp = L^-T (I + E^T Q_kk E) L^-1                         an eliminated point, 3 x 3

With T the tile's part of Q_kk below the diagonal and half of it on the diagonal, E^T Q_kk E = M + M^T, M = E^T T E: the
images of a tile that share no point have no block in the pool, and need none.
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
from jaxbundle.normals.point_blocks import PointFactor, backward
from jaxbundle.normals.products import contracted
from jaxbundle.normals.reduced_system import ReducedCofactors, ReducedSystem, factorise
from jaxbundle.normals.reduced_system import cofactors as reduced_cofactors
from jaxbundle.normals.step import AXIS, Linearised, device_mesh, linearise, local_tiles, partition, reduced_system


class Cofactors(NamedTuple):
    """Cofactors in the order of elimination, 0 for what is held; and the share of its own normal equation that the
    elimination left of each unknown (0: undetermined)."""

    images: Float[Array, "image d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    image_pivots: Float[Array, "image d"]
    border_pivots: Float[Array, " border"]
    point_pivots: Float[Array, "tile column"]
    system: ReducedSystem  # for who asks why a pivot failed


def cofactors(unknowns: Arranged, p: Problem) -> Cofactors:
    """Cofactors of the undamped normal equations; not finite where these are singular."""
    linear, free = linearise(unknowns, p), p.free_tiles
    if p.devices == 1:
        return _on_device(unknowns, linear, p, free, None)
    everywhere: Any = PartitionSpec()
    points: Any = PartitionSpec(None, None, AXIS)
    pivots: Any = PartitionSpec(AXIS)
    out = Cofactors(everywhere, everywhere, everywhere, points, everywhere, everywhere, pivots, everywhere)
    unknown_parts, linear_parts, problem_parts = partition(unknowns, linear, p)
    return jax.shard_map(
        partial(_on_device, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=(unknown_parts, linear_parts, problem_parts, PartitionSpec(None, AXIS)),
        out_specs=out,
        check_vma=False,
    )(unknowns, linear, p, free)


def _on_device(unknowns: Arranged, linear: Linearised, p: Problem, free: Array, axis: str | None) -> Cofactors:
    zero = jnp.zeros(())
    tiles = local_tiles(p.tiles)
    rays, _ = eliminate(
        p.observations, linear.table, unknowns.tiles, linear.prior, free, zero, tiles, p.shape, p.diagonal_pair
    )
    system = reduced_system(lax.psum(rays, axis) if axis else rays, linear.kept, p).system
    factor = factorise(p.reduced, system, zero)
    q = reduced_cofactors(p.reduced, factor)
    points, pivots = _points(unknowns, linear, p, free, tiles, q)
    images = q.pool.at[-1].set(0.0)[p.diagonal_pair]
    return Cofactors(images, q.coupling, q.border, points, factor.pivots, factor.border_pivots, pivots, system)


def _points(
    unknowns: Arranged, linear: Linearised, p: Problem, free: Array, tiles: tuple[Tiles, ...], q: ReducedCofactors
) -> tuple[Float[Array, "3 3 tile column"], Float[Array, "tile column"]]:
    """Cofactors and weakest pivots of the points of one device."""
    o, shape = p.observations, p.shape
    d, n = shape.image, unknowns.tiles.shape[2]
    inner = shape.shared * shape.cameras
    halved = q.pool.at[p.diagonal_pair].multiply(0.5).at[-1].set(0.0)

    def do_chunk(part: Tiles, c: Array, store: Array) -> Array:
        assert part.products is not None
        e = eliminate_chunk(o, linear.table, unknowns.tiles, linear.prior, free, jnp.zeros(()), part, c)
        coupling = coupling_rows(e, 0, d)
        m = part.products.quadratic(halved, coupling, c, e.chunk.tile_count)
        if inner:
            eb = border_rows(e, o, shape)
            at_group = jnp.take(eb, e.chunk.tile[:: part.group], axis=0, mode="clip")
            images = jnp.take(q.coupling[:, :, :inner], e.chunk.slot_image, axis=0, mode="clip")
            crossed = jnp.einsum("gab,gbk->gak", images.reshape(at_group.shape[0], -1, inner), at_group)
            by_slot = contracted(coupling.reshape(-1, d, 3, n), crossed.reshape(-1, d, 3, n))
            m = m.at[e.chunk.tile].add(by_slot)
            half = 0.5 * jnp.einsum("ab,tbk->tak", q.border[:inner, :inner], eb)
            m = m + contracted(eb.reshape(-1, inner, 3, n), half.reshape(-1, inner, 3, n))
        blocks, pivot = _point_blocks(e, m)
        rows = jnp.concatenate([blocks.reshape(-1, 9 * n), pivot], 1)
        return lax.dynamic_update_slice(store, rows, (e.chunk.first_tile, jnp.zeros_like(e.chunk.first_tile)))

    store = jnp.zeros((unknowns.tiles.shape[1], 10 * n))
    for part in tiles:
        store = lax.fori_loop(0, part.chunks, partial(do_chunk, part), store)
    return store[:, : 9 * n].reshape(-1, 3, 3, n).transpose(1, 2, 0, 3), store[:, 9 * n :]


def _point_blocks(e: Eliminated, m: Float[Array, "tile 3 3 n"]) -> tuple[Float[Array, "tile 3 3 n"], Array]:
    """L^-T (I + M + M^T) L^-1 and the smallest pivot's share."""
    n = m.shape[3]
    number = [e.factor[:, k * n : (k + 1) * n] for k in range(12)]
    f = PointFactor(*number[:6])
    c = [[m[:, i, j] + m[:, j, i] + (i == j) for j in range(3)] for i in range(3)]
    half = [backward(f, (c[0][j], c[1][j], c[2][j])) for j in range(3)]  # columns of L^-T C
    rows = [backward(f, (half[0][i], half[1][i], half[2][i])) for i in range(3)]
    shares = []
    for inverse_pivot, diagonal in zip(f[:3], number[9:], strict=True):
        free = (inverse_pivot != 0) & (diagonal > 0)
        shares.append(jnp.where(free, 1 / jnp.where(free, inverse_pivot**2 * diagonal, 1.0), 1.0))
    pivot = jnp.minimum(jnp.minimum(shares[0], shares[1]), shares[2])
    return jnp.stack([jnp.stack(row, 1) for row in rows], 1), pivot
