"""Elimination of the object points, tile by tile (Schur complement).

    [ U    W ] [dt]     [g_t]         V = L L^T   3 x 3 per point
    [ W^T  V ] [dX] = - [g_X]         E = W L^-T: one block of rows per image, z = L^-1 g_X

    (U + lambda D_t - E E^T) dt = -g_t + E z            D = diag(N), Marquardt's scaling; V includes lambda D_X

The Jacobian is never stored: a chunk of tiles is linearised and eliminated, and then discarded. With A and B the rows
of a ray, H = L^-1 B^T and y = H^T z, one product per slot of [A; a; v; y] with itself gives U, the coupling to the
border, both gradients and v^T P v; one product per tile of its E with itself gives the blocks of E E^T. Shared interior
elements, `a`, form the border: E_b = sum of the tile's rays.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxbundle.normals.chunks import (
    Chunk,
    at_slots,
    chunk_of,
    for_chunks,
    image_scalars,
    points_at_cells,
    sum_by_tile,
)
from jaxbundle.normals.pair_products import add_tile_products
from jaxbundle.normals.point_blocks import PAIRS, STORED, PointFactor, factorise, forward
from jaxbundle.normals.problem import Linearised, Problem, Tiles
from jaxbundle.normals.rows import ImageScalars, Ray, RayCurvature, ray_curvature, ray_rows, summed


class RaySums(NamedTuple):
    """Sums over the rays of each image, and the blocks of E E^T."""

    pairs: Float[Array, "pair d d"]
    """E E^T, lower blocks: rows belong to the image with the higher rank; the last block is a dummy."""
    image: Float[Array, "image m m"]
    """Product of [A; a; v; y] with itself."""
    coupling: Float[Array, "image d border"]
    """E E_b^T."""
    border: Float[Array, "border border"]
    """E_b E_b^T."""
    rotation: Float[Array, "image 9"] | None
    """Gradient with respect to the rotation matrix, if second derivatives are requested."""


class Eliminated(NamedTuple):
    """One chunk after elimination; index 0 of rows, H and residuals is the component."""

    chunk: Chunk
    image_rows: list[list[Array]]
    """A and a of each cell."""
    h: list[tuple[Array, Array, Array]]
    """H of each cell."""
    residual: tuple[Array, ...]
    z: list[Array]
    """The vector z at the slots."""
    stored: Float[Array, "tile value"]
    """See `point_equations`."""
    curvature: RayCurvature | None
    """Second derivatives, `mixed` times L^-T."""


def broadcast(image: ImageScalars, like: Array) -> ImageScalars:
    """Interior elements at each cell: derivatives must not be summed over the columns."""
    return image._replace(interior=tuple(jnp.broadcast_to(s, like.shape) for s in image.interior))


def eliminate_chunk(linear: Linearised, part: Tiles, c: Array, damping: Array) -> Eliminated:
    """Linearises and factorises the points of chunk `c`."""
    o, chunk, n = linear.problem.observations, chunk_of(part, c), linear.width
    image = image_scalars(at_slots(linear.table, chunk.slot_image))
    tile = chunk.first_tile + chunk.tile
    point = points_at_cells(chunk, list(linear.unknowns.tiles), tile, image.rotation, image.centre)
    ray = Ray(broadcast(image, chunk.weights[0]), point, chunk.measured, chunk.weights)
    rows = lax.optimization_barrier(ray_rows(o, ray))
    components = list(zip(rows.point, rows.residual, strict=True))
    terms: list[Any] = [sum(b[i] * b[j] for b, _ in components) for i, j in PAIRS]
    terms += [sum(b[i] * v for b, v in components) for i in range(3)]
    bend = ray_curvature(o, ray, chunk.zero) if linear.exact else None
    if bend is not None:
        terms[:6] = [t + b for t, b in zip(terms[:6], bend.point, strict=True)]
    sums = sum_by_tile(terms, chunk)
    if linear.point_terms is not None:
        sums = [s + chunk.window(terms) for s, terms in zip(sums, linear.point_terms, strict=True)]
    diagonal = [sums[0], sums[3], sums[5]]
    damped = [s * (1 + damping) if k in (0, 3, 5) else s for k, s in enumerate(sums[:6])]
    x, y, z = (chunk.window(f) for f in linear.free_tiles)
    factor = factorise((damped[0], damped[1], damped[2], damped[3], damped[4], damped[5]), (x, y, z))
    z = forward(factor, (sums[6], sums[7], sums[8]))
    of_tiles = jnp.concatenate(lax.optimization_barrier([*factor, *sums[6:], *diagonal, *z]), 1)
    taken = chunk.at_slots(of_tiles)
    column = [taken[:, k * n : (k + 1) * n] for k in range(STORED + 3)]
    f = PointFactor(*column[:6])
    h = lax.optimization_barrier([forward(f, b) for b in rows.point])
    if bend is not None:
        bend = bend._replace(mixed=[forward(f, (x, y, z)) for x, y, z in bend.mixed])
    return Eliminated(chunk, rows.image, h, rows.residual, column[STORED:], of_tiles[:, : STORED * n], bend)


def coupling_rows(e: Eliminated, first: int, count: int) -> Array:
    """E of some unknowns of each slot: (slot, count * 3 n), by unknown, coordinate, column."""
    unknowns, components = range(first, first + count), list(zip(e.image_rows, e.h, strict=True))
    blocks = [sum(a[u] * h[k] for a, h in components) for u in unknowns for k in range(3)]
    if e.curvature is not None:
        mixed = [e.curvature.mixed[u][k] for u in unknowns for k in range(3)]
        blocks = [x + y for x, y in zip(blocks, mixed, strict=True)]
    return jnp.concatenate(lax.optimization_barrier(blocks), 1)


def _image_products(e: Eliminated) -> Array:
    """The product of [A; a; v; y] with itself, (slot, m, m)."""
    y = [sum(h[k] * e.z[k] for k in range(3)) for h in e.h]
    rows = [*zip(*e.image_rows, strict=True), e.residual, y]
    joined = jnp.concatenate(lax.optimization_barrier([x for row in rows for x in row]), 1)
    joined = joined.reshape(joined.shape[0], len(rows), -1)
    return lax.dot_general(joined, joined, (((2,), (2,)), ((0,), (0,))))


def _curvature_sums(curvature: RayCurvature, m: int) -> tuple[Float[Array, "slot m m"], Float[Array, "slot 9"]]:
    """Second derivatives with respect to the unknowns of each image.

    They have the structure of `_image_products`; the gradient with respect to the rotation matrix is also returned.
    """
    k = len(curvature.image)
    row, column = np.tril_indices(k)
    place = np.zeros((k, k), int)
    place[row, column] = place[column, row] = np.arange(len(row))
    sums = summed(curvature.image)
    return jnp.pad(sums[:, place], ((0, 0), (0, m - k), (0, m - k))), jnp.concatenate(curvature.rotation, 1)


def border_rows(e: Eliminated, p: Problem) -> Float[Array, "tile border column"]:
    """The matrix E_b of each tile: the rows of its rays summed for each camera."""
    layout = p.layout
    rows = coupling_rows(e, layout.image, layout.shared)
    camera = p.observations.image_camera[e.chunk.slot_image]
    tiles = e.chunk.max_tiles
    of_tile = e.chunk.tile[None, None, :] == jnp.arange(tiles, dtype=jnp.int32)[:, None, None]
    of_camera = camera[None, None, :] == jnp.arange(layout.cameras, dtype=jnp.int32)[None, :, None]
    chosen = (of_tile & of_camera).astype(rows.dtype).reshape(-1, rows.shape[0])
    return (chosen @ rows).reshape(tiles, layout.first_parameter, -1)


def eliminate(linear: Linearised, damping: Array) -> tuple[RaySums, Float[Array, "tile value"]]:
    """All chunks of one device: sums for the reduced equations, and stored values of each point."""
    p = linear.problem
    d, images = p.layout.image, linear.table.shape[0]
    m, border = d + p.layout.shared + 2, p.layout.first_parameter

    def add_chunk(part: Tiles, c: Array, carry: tuple[RaySums, Array]) -> tuple[RaySums, Array]:
        sums, stored = carry
        e = eliminate_chunk(linear, part, c, damping)
        products, slot_image = _image_products(e), e.chunk.slot_image
        if e.curvature is not None and sums.rotation is not None:
            added, rotation = _curvature_sums(e.curvature, m)
            products = products + added
            rotation = sums.rotation.at[slot_image].add(rotation, mode="promise_in_bounds")
            sums = sums._replace(rotation=rotation)
        image = sums.image.at[slot_image].add(products, mode="promise_in_bounds")
        coupling = coupling_rows(e, 0, d)
        if part.pairs is None:
            own = coupling.reshape(coupling.shape[0], d, -1)
            product = lax.dot_general(own, own, (((2,), (2,)), ((0,), (0,))))
            pairs = sums.pairs.at[p.diagonal_pair[slot_image]].add(product, mode="promise_in_bounds")
        else:
            pairs = add_tile_products(sums.pairs, part, coupling, c, e.chunk.tile_count)
        sums = sums._replace(pairs=pairs, image=image)
        if border:
            eb = border_rows(e, p)
            at_group = jnp.take(eb, e.chunk.tile[:: part.group], axis=0, mode="clip")
            groups = coupling.reshape(at_group.shape[0], part.group * d, -1)
            cross = lax.dot_general(groups, at_group, (((2,), (2,)), ((0,), (0,)))).reshape(-1, d, border)
            sums = sums._replace(
                coupling=sums.coupling.at[slot_image].add(cross, mode="promise_in_bounds"),
                border=sums.border + jnp.einsum("tik,tjk->ij", eb, eb),
            )
        start = e.chunk.first_tile, jnp.zeros_like(e.chunk.first_tile)
        return sums, lax.dynamic_update_slice(stored, e.stored, start)

    sums = RaySums(
        jnp.zeros((p.layout.pairs, d, d)),
        jnp.zeros((images, m, m)),
        jnp.zeros((images, d, border)),
        jnp.zeros((border, border)),
        jnp.zeros((images, 9)) if linear.exact else None,
    )
    return for_chunks(p.tiles, add_chunk, (sums, jnp.zeros((linear.unknowns.tiles.shape[1], STORED * linear.width))))
