"""Leverages h = diag(A Q A^T P) of all observations: redundancy numbers are r = 1 - h (Baarda 1968).

With weighted rows a of the kept unknowns and b of an eliminated point, V = L L^T, h = L^-1 b^T, G = Q_kk E,

    a Q_kk a^T + 2 a Q_kX b^T + b Q_XX b^T  =  a Q_kk a^T - 2 a G h + h^T C h,      C = I + E^T Q_kk E

so a ray needs what its tile has at hand, and Q is never formed.
"""

from typing import NamedTuple

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


def cell_leverages(
    e: Eliminated,
    q: KeptCofactors,
    g: Float[Array, "slot d 3 n"],
    border_g: Float[Array, "slot shared 3 n"] | None,
    c: Float[Array, "tile 3 3 n"],
    camera: Array,
    shape: Shape,
) -> tuple[Float[Array, "slot n"], Float[Array, "slot n"]]:
    """Of x and of y of all cells of a chunk. `border_g`: G of the rows of the slot's own camera in the border."""
    slot_image, d, shared = e.chunk.slot_image, shape.image, shape.shared
    own = jnp.take(q.images, slot_image, axis=0, mode="clip")[..., None]
    at_slot = jnp.take(c, e.chunk.tile, axis=0, mode="clip")
    columns = shared * jnp.take(camera, slot_image, mode="clip")[:, None] + jnp.arange(shared)
    inner = mixed = jnp.zeros(())
    if border_g is not None:
        mixed = q.coupling[slot_image[:, None, None], jnp.arange(d)[:, None], columns[:, None, :]][..., None]
        inner = q.border[columns[:, :, None], columns[:, None, :]][..., None]

    def leverage(rows: Rows, h: Rows) -> Array:
        a, shared_a = rows[:d], rows[d:]
        coupled = [sum(a[k] * g[:, k, j] for k in range(d)) for j in range(3)]
        total = _form(a, own)
        if border_g is not None:
            coupled = [x + sum(b * border_g[:, k, j] for k, b in enumerate(shared_a)) for j, x in enumerate(coupled)]
            total = total + _form(shared_a, inner)
            total = total + 2 * sum(a[k] * b * mixed[:, k, j] for k in range(d) for j, b in enumerate(shared_a))
        total = total - 2 * sum(x * y for x, y in zip(coupled, h, strict=True))
        return total + sum(h[i] * h[j] * at_slot[:, i, j] for i in range(3) for j in range(3))

    (ax, ay), (hx, hy) = e.image_rows, e.h
    return leverage(ax, list(hx)), leverage(ay, list(hy))


def _form(rows: Rows, q: Float[Array, "slot k k 1"]) -> Array:
    """a Q a^T of every cell."""
    twice = [(1 if i == j else 2) * rows[i] * rows[j] * q[:, i, j] for i in range(len(rows)) for j in range(i + 1)]
    return sum(twice[1:], twice[0])


def kept_ray_leverages(
    rays: KeptRays, unknowns: Unknowns, turns: Array, o: Observations, shape: Shape, q: KeptCofactors
) -> list[Array]:
    """Of x and of y of the rays of kept points."""
    if rays.image.shape[0] == 0:
        return []
    touched, _ = kept_ray_rows(rays, unknowns, turns, o, shape)
    return list(_leverages(touched, q, None))


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
    total = _leverages(touched_by_group(group, rows, shape, point_column, camera_image), q, pairs)
    if group.kind.touches == ("point",):
        own = points.at[:, :, group.indices[0]].get(mode="fill", fill_value=0.0)
        total = total + jnp.einsum("cim,ijm,cjm->cm", rows.rows[0], own, rows.rows[0])
    return total


def _leverages(touched: list[Touched], q: KeptCofactors, pairs: Array | None) -> Float[Array, "component member"]:
    total = jnp.zeros(())
    touched = [a for a in touched if q.border.size or not a.in_border]  # eliminated points have no place in a border
    for a in touched:
        for b in touched:
            total = total + jnp.einsum("cpm,mpq,cqm->cm", a.rows, _between(a, b, q, pairs), b.rows)
    return total


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
