"""Transposed derivative of cofactors and leverages by unknowns and observations.

For a symmetric W in the blocks that are computed and weights k of the leverages, with the rows a of A,

    phi = <W, Q> + sum of k h  =  d/dt log det N(t) at t = 0,        N(t) = A^T (I + t diag k) A + t W

The gradient of log det N is 2 Q a for every row; so the gradient of phi is

    sum over the rows of  2 y da,        y = k Q a + Q' a,        Q' = -Q N' Q

Q' a is a forward derivative, along t, of what gives the leverages: Q is never formed, nor anything of the size of A.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from jaxbundle.block.unknowns import Unknowns, attitude_derivatives
from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cell_gradient import OfTiles, gradient_of_tiles
from jaxbundle.normals.eliminate import PAIRS, image_table
from jaxbundle.normals.kept import Touched, kept_ray_rows, touched_by_group
from jaxbundle.normals.leverage import KeptCofactors, point_products, touched_products
from jaxbundle.normals.partition import EVERYWHERE, OF_TILES
from jaxbundle.normals.rows import group_rows
from jaxbundle.normals.step import Linearised, linearise, partition
from jaxbundle.numerics.devices import AXIS, device_mesh
from jaxbundle.numerics.linear_map import directional

OF_ROWS: Any = PartitionSpec(AXIS)
Rows = list[list[Array]]  # of every group, by every touched entity


class CofactorWeights(NamedTuple):
    """W in the blocks of images, border and eliminated points, and k, as `Cofactors` lists the leverages."""

    images: Float[Array, "image d d"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    leverages: list[Array]


def cofactor_gradient(unknowns: Arranged, p: Problem, w: CofactorWeights) -> tuple[Arranged, Problem]:
    """Gradient of phi by the unknowns and by all numbers of the observations; None in place of what is no number."""
    cells, others = w.leverages[: 2 * len(p.tiles)], w.leverages[2 * len(p.tiles) :]
    moved = _moved(p, cells, others)
    linear = _with_weights(*directional(lambda p: linearise(unknowns, p), (p,), (moved,)), w, unknowns)
    found = _of_tiles(unknowns, linear, p, [t.weights for t in moved.tiles], cells)
    directions = _directions(unknowns, p, moved, found, others)
    by_unknowns, by_problem = eqx.filter_grad(lambda given: _product(_rows(*given), directions))((unknowns, p))

    def table(images: Unknowns) -> Array:
        o = p.observations
        return image_table(images, attitude_derivatives(images.rotation, o.in_angles, o.system), o)

    (by_images,) = jax.vjp(table, unknowns.images)[1](found.table)
    by_unknowns = jax.tree.map(jnp.add, by_unknowns, Arranged(by_images, found.tiles))
    tiles = zip(by_problem.tiles, found.measured, found.weights, strict=True)
    tiles = tuple(dataclasses.replace(t, measured=m, weights=w) for t, m, w in tiles)
    return by_unknowns, dataclasses.replace(by_problem, tiles=tiles)


def _moved(p: Problem, cells: list[Array], others: list[Array]) -> Problem:
    """How the observations move with t: the square roots of the weights by k / 2 of themselves."""
    nothing: Problem = jax.tree.map(lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, p)
    tiles = [0.5 * t.weights * jnp.stack(cells[2 * i : 2 * i + 2], 2) for i, t in enumerate(p.tiles)]
    o, rays, of_groups = nothing.observations, p.kept_rays.weights, others
    if rays.shape[1]:
        rays, of_groups = 0.5 * rays * jnp.stack(others[:2]), others[2:]
    groups = []
    for group, none, k in zip(p.observations.groups, o.groups, of_groups, strict=True):
        weights = 0.5 * group.weights * (k if group.weights.ndim == 2 else k[:, None])
        groups.append(dataclasses.replace(none, weights=weights))
    return dataclasses.replace(
        nothing,
        observations=dataclasses.replace(o, groups=tuple(groups)),
        tiles=tuple(dataclasses.replace(t, weights=w) for t, w in zip(nothing.tiles, tiles, strict=True)),
        kept_rays=dataclasses.replace(nothing.kept_rays, weights=rays),
    )


def _with_weights(
    linear: Linearised, moved: Linearised, w: CofactorWeights, unknowns: Arranged
) -> tuple[Linearised, Linearised]:
    """The linearised equations, and how they move with t."""
    images, border = (0.5 * (m + m.swapaxes(-1, -2)) for m in (w.images, w.border))
    kept = moved.kept._replace(diagonal=moved.kept.diagonal + images, border=moved.kept.border + border)
    nothing = jnp.zeros((9, *unknowns.tiles.shape[1:]))
    here, along = (nothing if x.prior is None else x.prior for x in (linear, moved))
    along = along.at[:6].add(jnp.stack([0.5 * (w.points[i, j] + w.points[j, i]) for i, j in PAIRS]))
    return linear._replace(prior=here), moved._replace(kept=kept, prior=along)


def _of_tiles(
    unknowns: Arranged, linear: tuple[Linearised, Linearised], p: Problem, weights: list[Array], cells: list[Array]
) -> OfTiles:
    """The tiles of all devices."""
    given = unknowns, linear, p, weights, cells, p.free_tiles
    if p.devices == 1:
        return gradient_of_tiles(*given, None)
    of_unknowns, of_linear, of_problem = partition(unknowns, linear[0], p)
    parts = of_unknowns, (of_linear, of_linear), of_problem, OF_ROWS, OF_ROWS, OF_TILES
    out: Any = EVERYWHERE, OF_ROWS, EVERYWHERE, OF_TILES, OF_ROWS, OF_ROWS
    return jax.shard_map(
        partial(gradient_of_tiles, axis=AXIS),
        mesh=device_mesh(p.devices),
        in_specs=parts,
        out_specs=OfTiles(*out),
        check_vma=False,
    )(*given)


def _touched(unknowns: Arranged, p: Problem) -> list[tuple[list[Touched], Array | None]]:
    """Rows of everything that is no ray of an eliminated point, and the pool's blocks of its pairs of images."""
    o, images, touched = p.observations, unknowns.images, []
    turns = attitude_derivatives(images.rotation, o.in_angles, o.system)
    if p.kept_rays.image.shape[0]:
        touched.append((kept_ray_rows(p.kept_rays, images, turns, o, p.shape)[0], None))
    flat = unknowns.flat() if o.groups else images
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        rows = group_rows(group, flat, turns, o.columns)
        touched.append((touched_by_group(group, rows, p.shape, p.point_column, p.camera_image), pairs))
    return touched


def _rows(unknowns: Arranged, p: Problem) -> Rows:
    """The rows alone; those of eliminated points among them."""
    return [[a.rows for a in touched] for touched, _ in _touched(unknowns, p)]


def _directions(unknowns: Arranged, p: Problem, moved: Problem, found: OfTiles, k: list[Array]) -> Rows:
    """2 y of these rows."""

    def products(p: Problem, q: KeptCofactors, points: Float[Array, "tile number"]) -> Rows:
        n, of_groups = unknowns.tiles.shape[2], []
        blocks = points.reshape(-1, 3, 3, n).transpose(1, 2, 0, 3).reshape(3, 3, -1)
        groups = [*([None] if p.kept_rays.image.shape[0] else []), *p.observations.groups]
        for (touched, pairs), group in zip(_touched(unknowns, p), groups, strict=True):
            rows = touched_products(touched, q, pairs)
            if group is not None and group.kind.touches == ("point",):
                rows[0] = rows[0] + point_products(group, touched[0].rows, blocks)
            of_groups.append(rows)
        return of_groups

    (q, q_moved), (points, points_moved) = found.kept, found.points
    here, along = directional(products, (p, q, points), (moved, q_moved, points_moved))
    factors = [jnp.stack(k[:2]), *k[2:]] if p.kept_rays.image.shape[0] else k
    # the rows times the root of 1 + t k have moved by k / 2: the other half comes here
    return [
        [factor[:, None] * a + 2 * b for a, b in zip(rows, rows_moved, strict=True)]
        for factor, rows, rows_moved in zip(factors, here, along, strict=True)
    ]


def _product(rows: Rows, directions: Rows) -> Float[Array, ""]:
    pairs = zip(jax.tree.leaves(rows), jax.tree.leaves(directions), strict=True)
    return sum((jnp.sum(a * b) for a, b in pairs), jnp.zeros(()))
