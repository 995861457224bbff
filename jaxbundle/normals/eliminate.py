"""Elimination of the object points, tile by tile (Schur complement).

    [ U    W ] [dt]     [g_t]         V = L L^T   3 x 3 a point
    [ W^T  V ] [dX] = - [g_X]         E = W L^-T: one block of rows an image, z = L^-1 g_X

    (U + lambda D_t - E E^T) dt = -g_t + E z            D = diag(N), Marquardt's scaling; V carries lambda D_X

The Jacobian is never stored: a chunk of tiles is linearised, eliminated and forgotten. With A and B the rows of a ray,
H = L^-1 B^T and y = H^T z, one product a slot of [A; a; v; y] with itself gives U, the coupling to the border, both
gradients and v^T P v; one product a tile of its E with itself gives the blocks of E E^T. Shared interior elements, `a`,
form the border: E_b = sum of the tile's rays.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals.cells import Chunk, Tiles, at_slots, chunk_of, points_at_cells, sum_by_tile
from jaxbundle.normals.curvature import RayCurvature, ray_curvature, summed
from jaxbundle.normals.point_blocks import PointFactor, factorise, forward
from jaxbundle.normals.rows import ImageScalars, ray_rows

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
FACTOR = 12  # numbers kept of a point: factor (6), gradient (3), diagonal of V (3)


class Shape(NamedTuple):
    """Static sizes: unknowns an image (6, or more where every image has its own camera), interior elements a shared
    camera, shared cameras, parameters, kept points, blocks of the pool, whether the reduced matrix is not formed,
    points a tile.

    The border: interior of shared cameras, parameters, then kept points.
    """

    image: int
    shared: int
    cameras: int
    parameters: int
    kept: int
    pool: int
    implicit: bool  # the pool has diagonal blocks only
    width: int

    @property
    def first_parameter(self) -> int:
        """Rows of the border before the parameters."""
        return self.shared * self.cameras

    @property
    def first_kept_point(self) -> int:
        """Rows of the border before the kept points."""
        return self.first_parameter + self.parameters

    @property
    def border(self) -> int:
        """Rows of the border."""
        return self.first_kept_point + 3 * self.kept


class ImageSums(NamedTuple):
    """Sums over the rays of every image, and the blocks of E E^T."""

    pool: Float[Array, "pair d d"]  # of E E^T, lower: the image of higher rank gives the rows; last one waste
    image: Float[Array, "image m m"]  # [A; a; v; y] with itself
    coupling: Float[Array, "image d border"]  # of E E_b^T
    border: Float[Array, "border border"]  # of E_b E_b^T
    rotation: Float[Array, "image 9"] | None  # gradient by the rotation matrix, where second derivatives are wanted


def image_table(
    unknowns: Unknowns, turns: Float[Array, "9 3 image"], observations: Observations
) -> Float[Array, "image number"]:
    """What every ray takes from its image, one row an image: rotation, its derivatives, centre, interior elements."""
    interior = unknowns.interior[:, observations.image_camera]
    return jnp.concatenate([unknowns.rotation, turns.transpose(1, 0, 2).reshape(27, -1), unknowns.centre, interior]).T


def image_scalars(at: list[Array]) -> ImageScalars:
    """A row of the table as the image equation takes it."""
    turns = tuple(tuple(at[9 + 9 * a : 18 + 9 * a]) for a in range(3))
    return ImageScalars(tuple(at[:9]), (turns[0], turns[1], turns[2]), (at[36], at[37], at[38]), tuple(at[39:]))


def broadcast(image: ImageScalars, like: Array) -> ImageScalars:
    """Interior on every cell: what is differentiated must not be summed over the columns."""
    return image._replace(interior=tuple(jnp.broadcast_to(s, like.shape) for s in image.interior))


class Eliminated(NamedTuple):
    """One chunk after elimination: A and H of every cell, factors of its tiles."""

    chunk: Chunk
    image_rows: tuple[list[Array], list[Array]]
    h: tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]
    residual: tuple[Array, Array]
    z: list[Array]  # at the slots
    factor: Array  # (tile, FACTOR n)
    curvature: RayCurvature | None  # `mixed` times L^-T


def eliminate_chunk(
    observations: Observations,
    table: Array,
    points: Float[Array, "3 tile column"],
    prior: Float[Array, "9 tile column"] | None,
    free: Bool[Array, "3 tile column"],
    damping: Array,
    tiles: Tiles,
    c: Array,
    exact: bool = False,
) -> Eliminated:
    """Linearises and factorises the points of a chunk. `prior`: V and gradient from observations other than rays;
    `exact`: with all second derivatives."""
    chunk = chunk_of(tiles, c)
    n = chunk.used.shape[1]
    image = image_scalars(at_slots(table, chunk.slot_image))
    point = points_at_cells(chunk, list(points), chunk.first_tile + chunk.tile, image.rotation, image.centre)
    scalars = broadcast(image, chunk.weights[0])
    rows = ray_rows(observations.model, observations.columns, scalars, point, chunk.measured, chunk.weights)
    rows = lax.optimization_barrier(rows)
    (bx, by), (vx, vy) = rows.point, rows.residual
    terms = [bx[i] * bx[j] + by[i] * by[j] for i, j in PAIRS] + [bx[i] * vx + by[i] * vy for i in range(3)]
    bend = None
    if exact:
        ray = scalars, point, chunk.measured, chunk.weights
        bend = ray_curvature(observations.model, observations.columns, *ray, chunk.zero)
        terms[:6] = [t + b for t, b in zip(terms[:6], bend.point, strict=True)]
    sums = sum_by_tile(terms, chunk)
    if prior is not None:
        sums = [s + chunk.window(p) for s, p in zip(sums, prior, strict=True)]
    diagonal = [sums[0], sums[3], sums[5]]
    damped = [s * (1 + damping) if k in (0, 3, 5) else s for k, s in enumerate(sums[:6])]
    is_free = [chunk.window(f) for f in free]
    factor = factorise(
        (damped[0], damped[1], damped[2], damped[3], damped[4], damped[5]), (is_free[0], is_free[1], is_free[2])
    )
    z = forward(factor, (sums[6], sums[7], sums[8]))
    kept = jnp.concatenate(lax.optimization_barrier([*factor, *sums[6:], *diagonal, *z]), 1)
    at_slot = jnp.take(kept, chunk.tile, axis=0, mode="clip")
    column = [at_slot[:, k * n : (k + 1) * n] for k in range(15)]
    f = PointFactor(*column[:6])
    h = lax.optimization_barrier((forward(f, bx), forward(f, by)))
    if bend is not None:
        bend = bend._replace(mixed=[forward(f, (x, y, z)) for x, y, z in bend.mixed])
    return Eliminated(chunk, rows.image, h, (vx, vy), column[12:], kept[:, : FACTOR * n], bend)


def coupling_rows(e: Eliminated, first: int, count: int) -> Array:
    """E of some unknowns of every slot: (slot, count * 3 n), by unknown, coordinate, column."""
    (ax, ay), (hx, hy), unknowns = e.image_rows, e.h, range(first, first + count)
    blocks = [ax[a] * hx[k] + ay[a] * hy[k] for a in unknowns for k in range(3)]
    if e.curvature is not None:
        mixed = [e.curvature.mixed[a][k] for a in unknowns for k in range(3)]
        blocks = [x + y for x, y in zip(blocks, mixed, strict=True)]
    return jnp.concatenate(lax.optimization_barrier(blocks), 1)


def _image_products(e: Eliminated) -> Array:
    """[A; a; v; y] with itself, (slot, m, m)."""
    (ax, ay), (vx, vy), (hx, hy) = e.image_rows, e.residual, e.h
    y = [sum(h[k] * e.z[k] for k in range(3)) for h in (hx, hy)]
    pairs = [*zip(ax, ay, strict=True), (vx, vy), (y[0], y[1])]
    rows = jnp.concatenate(lax.optimization_barrier([x for pair in pairs for x in pair]), 1)
    rows = rows.reshape(rows.shape[0], len(pairs), -1)
    return lax.dot_general(rows, rows, (((2,), (2,)), ((0,), (0,))))


def _curvature_sums(curvature: RayCurvature, m: int) -> tuple[Float[Array, "slot m m"], Float[Array, "slot 9"]]:
    """Of the unknowns of every image, as `_image_products` has them, and the gradient by the rotation matrix."""
    k = len(curvature.image)
    row, column = np.tril_indices(k)
    place = np.zeros((k, k), int)
    place[row, column] = place[column, row] = np.arange(len(row))
    sums = summed(curvature.image)
    return jnp.pad(sums[:, place], ((0, 0), (0, m - k), (0, m - k))), jnp.concatenate(curvature.rotation, 1)


def border_rows(e: Eliminated, observations: Observations, shape: Shape) -> Float[Array, "tile border column"]:
    """E_b of every tile: the rows of its rays summed by camera."""
    rows = coupling_rows(e, shape.image, shape.shared)
    camera = observations.image_camera[e.chunk.slot_image]
    tiles = e.chunk.most_tiles
    of_tile = e.chunk.tile[None, None, :] == jnp.arange(tiles)[:, None, None]
    of_camera = camera[None, None, :] == jnp.arange(shape.cameras)[None, :, None]
    chosen = (of_tile & of_camera).astype(rows.dtype).reshape(-1, rows.shape[0])
    return (chosen @ rows).reshape(tiles, shape.cameras * shape.shared, -1)


def eliminate(
    observations: Observations,
    table: Array,
    points: Float[Array, "3 tile column"],
    prior: Float[Array, "9 tile column"] | None,
    free: Bool[Array, "3 tile column"],
    damping: Array,
    tiles: tuple[Tiles, ...],
    shape: Shape,
    diagonal_pair: Int[Array, " image"],
    exact: bool = False,
) -> tuple[ImageSums, Float[Array, "tile numbers"]]:
    """All chunks of one device: sums for the reduced equations, and factor, gradient and diagonal of every point."""
    d, q, images, n = shape.image, shape.shared, table.shape[0], points.shape[2]
    m, border = d + q + 2, q * shape.cameras

    def add_chunk(part: Tiles, c: Array, carry: tuple[ImageSums, Array]) -> tuple[ImageSums, Array]:
        sums, factors = carry
        e = eliminate_chunk(observations, table, points, prior, free, damping, part, c, exact)
        products = _image_products(e)
        if e.curvature is not None and sums.rotation is not None:
            added, rotation = _curvature_sums(e.curvature, m)
            products = products + added
            rotation = sums.rotation.at[e.chunk.slot_image].add(rotation, mode="promise_in_bounds")
            sums = sums._replace(rotation=rotation)
        image = sums.image.at[e.chunk.slot_image].add(products, mode="promise_in_bounds")
        coupling = coupling_rows(e, 0, d)
        if part.products is None:
            own = coupling.reshape(coupling.shape[0], d, -1)
            product = lax.dot_general(own, own, (((2,), (2,)), ((0,), (0,))))
            pool = sums.pool.at[diagonal_pair[e.chunk.slot_image]].add(product, mode="promise_in_bounds")
        else:
            pool = part.products.added(sums.pool, coupling, c, e.chunk.tile_count)
        sums = sums._replace(pool=pool, image=image)
        if border:
            eb = border_rows(e, observations, shape)
            at_group = jnp.take(eb, e.chunk.tile[:: part.group], axis=0, mode="clip")
            groups = coupling.reshape(at_group.shape[0], part.group * d, -1)
            cross = lax.dot_general(groups, at_group, (((2,), (2,)), ((0,), (0,)))).reshape(-1, d, border)
            sums = sums._replace(
                coupling=sums.coupling.at[e.chunk.slot_image].add(cross, mode="promise_in_bounds"),
                border=sums.border + jnp.einsum("tik,tjk->ij", eb, eb),
            )
        start = e.chunk.first_tile, jnp.zeros_like(e.chunk.first_tile)
        return sums, lax.dynamic_update_slice(factors, e.factor, start)

    sums = ImageSums(
        jnp.zeros((shape.pool, d, d)),
        jnp.zeros((images, m, m)),
        jnp.zeros((images, d, border)),
        jnp.zeros((border, border)),
        jnp.zeros((images, 9)) if exact else None,
    )
    carry = sums, jnp.zeros((points.shape[1], FACTOR * n))
    for part in tiles:
        carry = lax.fori_loop(0, part.chunks, partial(add_chunk, part), carry)
    return carry
