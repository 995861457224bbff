"""Leverages h = diag(A Q A^T P) of all observations: redundancy numbers are r = 1 - h (Baarda 1968).

With weighted rows a of images and border and b of an eliminated point, V = L L^T, h = L^-1 b^T, G = Q_rr E,

    a Q_rr a^T + 2 a Q_rX b^T + b Q_XX b^T  =  a (Q_rr a^T - G h) + h^T (C h - G^T a^T),      C = I + E^T Q_rr E

so a ray needs only values of its tile, and Q is never formed. The factors in brackets are Q times the row.
"""

from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Group
from jaxbundle.normals.eliminate import Eliminated
from jaxbundle.normals.observation_rows import Touched, border_ray_rows, group_rows, touched_by_group
from jaxbundle.normals.problem import Linearised, Problem

Rows = list[Array]


class ReducedCofactors(NamedTuple):
    """Cofactors of images and border: of each image, of pairs with blocks, with the border, of the border."""

    images: Float[Array, "image d d"]
    pairs: Float[Array, "pair d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]


class TileCofactors(NamedTuple):
    """Parts of the cofactors of a chunk's rays."""

    g: Float[Array, "slot d 3 n"]
    """Rows of G for each slot's image."""
    border_g: Float[Array, "slot shared 3 n"] | None
    """Rows of G for each slot's camera in the border."""
    c: Float[Array, "tile 3 3 n"]
    """The matrix C of the points."""


class CellProducts(NamedTuple):
    """Q times the row of all cells of a chunk.

    It has parts for the unknowns of the image and of a shared camera, and for the point: C h - G^T a, which L^-T
    converts to X, Y, Z.
    """

    image: Rows
    camera: Rows
    point: Rows


def cell_products(e: Eliminated, q: ReducedCofactors, t: TileCofactors, p: Problem) -> list[CellProducts]:
    """Q times the rows of all components."""
    layout, slot_image = p.layout, e.chunk.slot_image
    d, shared = layout.image, layout.shared
    own = jnp.take(q.images, slot_image, axis=0, mode="clip")[..., None]
    at_slot = e.chunk.at_slots(t.c)
    inner = mixed = jnp.zeros(())
    if t.border_g is not None:
        rows = layout.camera_rows(jnp.take(p.observations.image_camera, slot_image, mode="clip"))
        mixed = q.coupling[slot_image[:, None, None], jnp.arange(d)[:, None], rows[:, None, :]][..., None]
        inner = q.border[rows[:, :, None], rows[:, None, :]][..., None]

    def product(rows: Rows, h: Rows) -> CellProducts:
        a, b = rows[:d], rows[d:]
        image = [_dot(a, own[:, k].swapaxes(0, 1)) - _dot(h, t.g[:, k].swapaxes(0, 1)) for k in range(d)]
        point = [_dot(h, at_slot[:, j].swapaxes(0, 1)) - _dot(a, t.g[:, :, j].swapaxes(0, 1)) for j in range(3)]
        if t.border_g is None:
            return CellProducts(image, [], point)
        image = [x + _dot(b, mixed[:, k].swapaxes(0, 1)) for k, x in enumerate(image)]
        point = [x - _dot(b, t.border_g[:, :, j].swapaxes(0, 1)) for j, x in enumerate(point)]
        of_camera = [
            _dot(a, mixed[:, :, k].swapaxes(0, 1))
            + _dot(b, inner[:, k].swapaxes(0, 1))
            - _dot(h, t.border_g[:, k].swapaxes(0, 1))
            for k in range(shared)
        ]
        return CellProducts(image, of_camera, point)

    return [product(rows, list(h)) for rows, h in zip(e.image_rows, e.h, strict=True)]


def _dot(a: Any, b: Any) -> Any:
    return reduce(add, (x * y for x, y in zip(a, b, strict=True)))


def cell_leverages(e: Eliminated, products: list[CellProducts]) -> list[Array]:
    """Leverages of each component of all cells of a chunk, (slot, n)."""
    return [
        _dot([*rows, *h], [*q.image, *q.camera, *q.point])
        for rows, h, q in zip(e.image_rows, e.h, products, strict=True)
    ]


def border_ray_leverages(linear: Linearised, q: ReducedCofactors) -> list[Array]:
    """Leverages of each component of the rays of border points."""
    if not linear.problem.border_rays:
        return []
    touched, _ = border_ray_rows(linear.unknowns.images, linear.d_rotation, linear.problem)
    return list(_leverages(touched, touched_products(touched, q, None)))


def group_leverages(
    linear: Linearised, q: ReducedCofactors, points: Float[Array, "3 3 point"]
) -> list[Float[Array, "_component _member"]]:
    """Leverages of all components of all groups; `points`: cofactors of the eliminated points."""
    p, o, found = linear.problem, linear.problem.observations, []
    flat = linear.unknowns.flat() if o.groups else linear.unknowns.images
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        rows = group_rows(group, flat, linear.d_rotation, o.columns).rows
        touched = touched_by_group(group, rows, p)
        total = _leverages(touched, touched_products(touched, q, pairs))
        if group.kind.touches == ("point",):
            total = total + jnp.einsum("cim,cim->cm", rows[0], point_products(group, rows[0], points))
        found.append(total)
    return found


def touched_products(touched: list[Touched], q: ReducedCofactors, pairs: Array | None) -> list[Array]:
    """Q times the rows, for each touched entity."""
    products = []
    for a in touched:
        if a.in_border and not q.border.size:  # eliminated points have no row in a border
            products.append(jnp.zeros_like(a.rows))
            continue
        there = [b for b in touched if q.border.size or not b.in_border]
        products.append(sum(jnp.einsum("mpq,cqm->cpm", _between(a, b, q, pairs), b.rows) for b in there))
    return products


def point_products(group: Group, rows: Array, points: Float[Array, "3 3 point"]) -> Float[Array, "component 3 member"]:
    """Q times the rows of observations of one eliminated point each."""
    own = points.at[:, :, group.indices[0]].get(mode="fill", fill_value=0.0)
    return jnp.einsum("ijm,cjm->cim", own, rows)


def _leverages(touched: list[Touched], products: list[Array]) -> Float[Array, "component member"]:
    terms = (jnp.einsum("cpm,cpm->cm", a.rows, product) for a, product in zip(touched, products, strict=True))
    return sum(terms, jnp.zeros(()))


def _between(a: Touched, b: Touched, q: ReducedCofactors, pairs: Array | None) -> Float[Array, "member p q"]:
    """Cofactors of two touched entities of each member; 0 for rows outside the border."""
    if a.in_border and b.in_border:
        return q.border.at[a.at[:, :, None], b.at[:, None, :]].get(mode="fill", fill_value=0.0)
    if a.in_border or b.in_border:
        image, border = (b, a) if a.in_border else (a, b)
        rows = jnp.arange(q.coupling.shape[1])[:, None]
        mixed = q.coupling.at[image.at[:, None, None], rows, border.at[:, None, :]].get(mode="fill", fill_value=0.0)
        return mixed.transpose(0, 2, 1) if a.in_border else mixed
    own = q.images[a.at]
    if pairs is None:
        return own
    lower = q.pairs[pairs]
    other = jnp.where((a.at > b.at)[:, None, None], lower, lower.transpose(0, 2, 1))
    return jnp.where((a.at == b.at)[:, None, None], own, other)
