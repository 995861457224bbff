"""Leverages h = diag(A Q A^T P) of all observations: redundancy numbers are r = 1 - h (Baarda 1968).

With weighted rows a of the kept unknowns and b of an eliminated point, V = L L^T, h = L^-1 b^T, G = Q_kk E,

    a Q_kk a^T + 2 a Q_kX b^T + b Q_XX b^T  =  a (Q_kk a^T - G h) + h^T (C h - G^T a^T),      C = I + E^T Q_kk E

so a ray needs what its tile has at hand, and Q is never formed. The factors in brackets are Q times the row.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Group, Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals.eliminate import Eliminated, Shape
from jaxbundle.normals.kept import KeptRays, Touched, kept_ray_rows, touched_by_group
from jaxbundle.normals.rows import group_rows

Rows = list[Array]


class KeptCofactors(NamedTuple):
    """Cofactors of the kept unknowns: of every image, of the pool's pairs of images, with the border, of the border."""

    images: Float[Array, "image d d"]
    pool: Float[Array, "pair d d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]


class CellProducts(NamedTuple):
    """Q of a row of all cells of a chunk: by the unknowns of the image, those of a shared camera, and the point,
    C h - G^T a, which L^-T turns to X, Y, Z."""

    image: Rows
    camera: Rows
    point: Rows


def cell_products(
    e: Eliminated,
    q: KeptCofactors,
    g: Float[Array, "slot d 3 n"],
    border_g: Float[Array, "slot shared 3 n"] | None,
    c: Float[Array, "tile 3 3 n"],
    camera: Array,
    shape: Shape,
) -> tuple[CellProducts, CellProducts]:
    """Of the rows of x and of y. `border_g`: G of the rows of the slot's own camera in the border."""
    slot_image, d, shared = e.chunk.slot_image, shape.image, shape.shared
    own = jnp.take(q.images, slot_image, axis=0, mode="clip")[..., None]
    at_slot = jnp.take(c, e.chunk.tile, axis=0, mode="clip")
    columns = shared * jnp.take(camera, slot_image, mode="clip")[:, None] + jnp.arange(shared)
    inner = mixed = jnp.zeros(())
    if border_g is not None:
        mixed = q.coupling[slot_image[:, None, None], jnp.arange(d)[:, None], columns[:, None, :]][..., None]
        inner = q.border[columns[:, :, None], columns[:, None, :]][..., None]

    def product(rows: Rows, h: Rows) -> CellProducts:
        a, b = rows[:d], rows[d:]
        image = [_dot(a, own[:, k].swapaxes(0, 1)) - _dot(h, g[:, k].swapaxes(0, 1)) for k in range(d)]
        point = [_dot(h, at_slot[:, j].swapaxes(0, 1)) - _dot(a, g[:, :, j].swapaxes(0, 1)) for j in range(3)]
        if border_g is None:
            return CellProducts(image, [], point)
        image = [x + _dot(b, mixed[:, k].swapaxes(0, 1)) for k, x in enumerate(image)]
        point = [x - _dot(b, border_g[:, :, j].swapaxes(0, 1)) for j, x in enumerate(point)]
        of_camera = [
            _dot(a, mixed[:, :, k].swapaxes(0, 1))
            + _dot(b, inner[:, k].swapaxes(0, 1))
            - _dot(h, border_g[:, k].swapaxes(0, 1))
            for k in range(shared)
        ]
        return CellProducts(image, of_camera, point)

    (ax, ay), (hx, hy) = e.image_rows, e.h
    return product(ax, list(hx)), product(ay, list(hy))


def _dot(a: Any, b: Any) -> Any:
    first, *terms = (x * y for x, y in zip(a, b, strict=True))
    return sum(terms, first)


def cell_leverages(e: Eliminated, products: tuple[CellProducts, CellProducts]) -> tuple[Array, Array]:
    """Of x and of y of all cells of a chunk, (slot, n)."""
    x, y = (
        _dot([*rows, *h], [*q.image, *q.camera, *q.point])
        for rows, h, q in zip(e.image_rows, e.h, products, strict=True)
    )
    return x, y


def kept_ray_leverages(
    rays: KeptRays, unknowns: Unknowns, turns: Array, o: Observations, shape: Shape, q: KeptCofactors
) -> list[Array]:
    """Of x and of y of the rays of kept points."""
    if rays.image.shape[0] == 0:
        return []
    touched, _ = kept_ray_rows(rays, unknowns, turns, o, shape)
    return list(_leverages(touched, touched_products(touched, q, None)))


def group_leverages(
    group: Group,
    pairs: Array | None,
    unknowns: Unknowns,
    turns: Array,
    o: Observations,
    shape: Shape,
    point_column: Array,
    camera_image: Array,
    q: KeptCofactors,
    points: Float[Array, "3 3 place"],
) -> Float[Array, "component member"]:
    """Of all components of a group; `points`: cofactors of the eliminated points."""
    rows = group_rows(group, unknowns, turns, o.columns)
    touched = touched_by_group(group, rows, shape, point_column, camera_image)
    total = _leverages(touched, touched_products(touched, q, pairs))
    if group.kind.touches == ("point",):
        total = total + jnp.einsum("cim,cim->cm", rows.rows[0], point_products(group, rows.rows[0], points))
    return total


def touched_products(touched: list[Touched], q: KeptCofactors, pairs: Array | None) -> list[Array]:
    """Q of the rows, by every touched entity."""
    products = []
    for a in touched:
        if a.in_border and not q.border.size:  # eliminated points have no place in a border
            products.append(jnp.zeros_like(a.rows))
            continue
        there = [b for b in touched if q.border.size or not b.in_border]
        products.append(sum(jnp.einsum("mpq,cqm->cpm", _between(a, b, q, pairs), b.rows) for b in there))
    return products


def point_products(group: Group, rows: Array, points: Float[Array, "3 3 place"]) -> Float[Array, "component 3 member"]:
    """Q of the rows of observations of one eliminated point each."""
    own = points.at[:, :, group.indices[0]].get(mode="fill", fill_value=0.0)
    return jnp.einsum("ijm,cjm->cim", own, rows)


def _leverages(touched: list[Touched], products: list[Array]) -> Float[Array, "component member"]:
    terms = (jnp.einsum("cpm,cpm->cm", a.rows, product) for a, product in zip(touched, products, strict=True))
    return sum(terms, jnp.zeros(()))


def _between(a: Touched, b: Touched, q: KeptCofactors, pairs: Array | None) -> Float[Array, "member p q"]:
    """Cofactors of two touched entities of every member; 0 where a column lies outside of the border."""
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
    lower = q.pool[pairs]
    other = jnp.where((a.at > b.at)[:, None, None], lower, lower.transpose(0, 2, 1))
    return jnp.where((a.at == b.at)[:, None, None], own, other)
