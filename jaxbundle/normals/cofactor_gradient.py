"""Transposed derivative of cofactors and leverages with respect to unknowns and observations.

For a symmetric W in the computed blocks and weights k of the leverages, with the rows a of A,

    phi = <W, Q> + sum of k h  =  d/dt log det N(t) at t = 0,        N(t) = A^T (I + t diag k) A + t W

The gradient of log det N is 2 Q a for each row; so the gradient of phi is

    sum over the rows of  2 y da,        y = k Q a + Q' a,        Q' = -Q N' Q

Q' a is a forward derivative along t of the computation of the leverages: neither Q nor a matrix of the size of A is
formed.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.block.unknowns import Unknowns, attitude_derivatives
from jaxbundle.normals.cell_gradient import GradientOfTiles, Varied, gradient_of_tiles
from jaxbundle.normals.chunks import BY_DEVICE, EVERYWHERE, OF_TILES, everywhere, image_table, over_devices
from jaxbundle.normals.leverage import ReducedCofactors, point_products, touched_products
from jaxbundle.normals.observation_rows import Touched, border_ray_rows, group_rows, touched_by_group
from jaxbundle.normals.point_blocks import PAIRS
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem
from jaxbundle.normals.step import linearise
from jaxbundle.numerics.linear_map import directional

Rows = list[list[Array]]  # for each group and each touched entity


class CofactorWeights(NamedTuple):
    """W in the blocks of images, border and eliminated points, and k, in the structure of `Cofactors`."""

    images: Float[Array, "image d d"]
    border: Float[Array, "border border"]
    points: Float[Array, "3 3 tile column"]
    leverages: list[Array]


def cofactor_gradient(unknowns: OrderedUnknowns, p: Problem, w: CofactorWeights) -> tuple[OrderedUnknowns, Problem]:
    """Gradient of phi with respect to the unknowns and all numbers of the observations; None for other fields."""
    count = p.observations.model.components * len(p.tiles)
    cells, others = w.leverages[:count], w.leverages[count:]
    problem_along = _problem_along(p, cells, others)
    linear, along = directional(lambda p: linearise(unknowns, p), (p,), (problem_along,))
    linear, varied = _with_weights(linear, along, w, [t.weights for t in problem_along.tiles])
    found = _of_tiles(linear, varied, cells)
    directions = _directions(linear, problem_along, found, others)
    by_unknowns, by_problem = eqx.filter_grad(lambda given: _product(_rows(*given), directions))((unknowns, p))

    def table(images: Unknowns) -> Array:
        o = p.observations
        return image_table(images, attitude_derivatives(images.rotation, o.in_angles, o.system), o)

    (by_images,) = jax.vjp(table, unknowns.images)[1](found.table)
    by_unknowns = jax.tree.map(jnp.add, by_unknowns, OrderedUnknowns(by_images, found.tiles))
    by_cells = [x for pair in zip(found.measured, found.weights, strict=True) for x in pair]
    by_problem = eqx.tree_at(lambda p: [x for t in p.tiles for x in (t.measured, t.weights)], by_problem, by_cells)
    return by_unknowns, by_problem


def _problem_along(p: Problem, cells: list[Array], others: list[Array]) -> Problem:
    """Derivatives of the observations with respect to t: the square roots of the weights change by the factor k / 2."""
    nothing: Problem = jax.tree.map(lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, p)
    components = p.observations.model.components
    of_tiles = [
        0.5 * t.weights * jnp.stack(cells[components * i : components * (i + 1)], 2) for i, t in enumerate(p.tiles)
    ]
    of_rays, of_groups = p.border_rays.weights, others
    if p.border_rays:
        of_rays, of_groups = 0.5 * of_rays * jnp.stack(others[:components]), others[components:]
    groups = [
        0.5 * group.weights * (k if group.weights.ndim == 2 else k[:, None])
        for group, k in zip(p.observations.groups, of_groups, strict=True)
    ]

    def weights(p: Problem) -> list[Any]:
        return [*(t.weights for t in p.tiles), p.border_rays.weights, *(g.weights for g in p.observations.groups)]

    return eqx.tree_at(weights, nothing, [*of_tiles, of_rays, *groups])


def _with_weights(
    linear: Linearised, along: Linearised, w: CofactorWeights, of_tiles: list[Array]
) -> tuple[Linearised, Varied]:
    """The linearised equations with blocks for W, and their derivatives with respect to t.

    `of_tiles`: weights of the tiles.
    """
    images, border = (0.5 * (m + m.swapaxes(-1, -2)) for m in (w.images, w.border))
    sums = along.sums._replace(diagonal=along.sums.diagonal + images, border=along.sums.border + border)
    nothing = jnp.zeros((9, *linear.unknowns.tiles.shape[1:]))
    here, there = (nothing if x.point_terms is None else x.point_terms for x in (linear, along))
    there = there.at[:6].add(jnp.stack([0.5 * (w.points[i, j] + w.points[j, i]) for i, j in PAIRS]))
    return dataclasses.replace(linear, point_terms=here), Varied(sums, there, of_tiles)


def _of_tiles(linear: Linearised, varied: Varied, cells: list[Array]) -> GradientOfTiles:
    """The gradient of the tiles of all devices."""
    out: Any = EVERYWHERE, BY_DEVICE, EVERYWHERE, OF_TILES, BY_DEVICE, BY_DEVICE
    parts = Varied(everywhere(varied.sums), OF_TILES, BY_DEVICE), BY_DEVICE
    return over_devices(gradient_of_tiles, linear, GradientOfTiles(*out), (varied, cells), parts)


def _touched(unknowns: OrderedUnknowns, p: Problem) -> list[tuple[list[Touched], Array | None]]:
    """Rows of all observations except rays of eliminated points, and the blocks of their pairs of images."""
    o, images, touched = p.observations, unknowns.images, []
    d_rotation = attitude_derivatives(images.rotation, o.in_angles, o.system)
    if p.border_rays:
        touched.append((border_ray_rows(images, d_rotation, p)[0], None))
    flat = unknowns.flat() if o.groups else images
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        touched.append((touched_by_group(group, group_rows(group, flat, d_rotation, o.columns).rows, p), pairs))
    return touched


def _rows(unknowns: OrderedUnknowns, p: Problem) -> Rows:
    """Only the rows, including those of eliminated points."""
    return [[a.rows for a in touched] for touched, _ in _touched(unknowns, p)]


def _directions(linear: Linearised, problem_along: Problem, found: GradientOfTiles, k: list[Array]) -> Rows:
    """The directions 2 y of these rows."""
    unknowns, p = linear.unknowns, linear.problem

    def products(p: Problem, q: ReducedCofactors, points: Float[Array, "tile number"]) -> Rows:
        of_groups = []
        blocks = points.reshape(-1, 3, 3, linear.width).transpose(1, 2, 0, 3).reshape(3, 3, -1)
        groups = [*([None] if p.border_rays else []), *p.observations.groups]
        for (touched, pairs), group in zip(_touched(unknowns, p), groups, strict=True):
            rows = touched_products(touched, q, pairs)
            if group is not None and group.kind.touches == ("point",):
                rows[0] = rows[0] + point_products(group, touched[0].rows, blocks)
            of_groups.append(rows)
        return of_groups

    (q, q_along), (points, points_along) = found.reduced, found.points
    here, along = directional(products, (p, q, points), (problem_along, q_along, points_along))
    components = p.observations.model.components
    factors = [jnp.stack(k[:components]), *k[components:]] if p.border_rays else k
    # the rows times the root of 1 + t k change by k / 2: the other half is added here
    return [
        [factor[:, None] * a + 2 * b for a, b in zip(rows, rows_along, strict=True)]
        for factor, rows, rows_along in zip(factors, here, along, strict=True)
    ]


def _product(rows: Rows, directions: Rows) -> Float[Array, ""]:
    pairs = zip(jax.tree.leaves(rows), jax.tree.leaves(directions), strict=True)
    return sum((jnp.sum(a * b) for a, b in pairs), jnp.zeros(()))
