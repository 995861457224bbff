"""Rows of observations that are not rays of the tiles: their part of the reduced normal equations.

Their unknowns are rows of the images' blocks (exterior orientation, and the interior of an image's own camera) or of
the border (interior of shared cameras, parameters, then border points):

    [ S_II  S_Ib ]     S_II  blocks d x d of pairs of images: diagonal ones separate from the others
    [       S_bb ]     S_Ib  d rows per image, S_bb dense
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Group, touched_values, weighted
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.normals.chunks import is_used
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.point_blocks import PAIRS
from jaxbundle.normals.problem import Problem, ReducedSums
from jaxbundle.normals.rows import ImageScalars, Ray, chained, ray_rows

Rotations = Float[Array, "9 3 image"]


class Touched(NamedTuple):
    """Rows of one touched entity: in an image's block or in rows of the border."""

    rows: Float[Array, "component parameter member"]
    in_border: bool
    at: Int[Array, "member *parameter"]
    """Image of each member, or rows of the border; indices outside are dropped."""


class GroupRows(NamedTuple):
    """Weighted residuals and rows of a group; one entry of `rows` for each touched entity."""

    residuals: Float[Array, "component member"]
    rows: tuple[Float[Array, "_component _parameter _member"], ...]


def no_sums(p: Problem, images: int) -> ReducedSums:
    """Empty sums, all 0."""
    d, border = p.layout.image, p.layout.border
    two_images = any(pairs is not None for pairs in p.group_pairs)
    return ReducedSums(
        jnp.zeros((images, d, d)),
        jnp.zeros((images, d)),
        jnp.zeros((images, d, border)),
        jnp.zeros((border, border)),
        jnp.zeros(border),
        jnp.zeros((p.layout.pairs, d, d)) if two_images else None,
    )


def add_rows(
    sums: ReducedSums, touched: list[Touched], residuals: Float[Array, "component member"], pairs: Array | None
) -> ReducedSums:
    """Adds observations. `pairs`: the block of the first two touched images, if there are two."""
    for a in touched:
        gradient = jnp.einsum("cpm,cm->mp", a.rows, residuals)
        if a.in_border:
            sums = sums._replace(border_gradient=sums.border_gradient.at[a.at].add(gradient, mode="drop"))
        else:
            sums = sums._replace(gradient=sums.gradient.at[a.at].add(gradient))
    return add_products(sums, touched, None, pairs)


def add_products(
    sums: ReducedSums,
    touched: list[Touched],
    metric: Float[Array, "component component member"] | None,
    pairs: Array | None,
) -> ReducedSums:
    """Adds the products of all rows with all others, A^T A, or A^T M A with a metric."""
    for i, a in enumerate(touched):
        left = a.rows if metric is None else jnp.einsum("cpm,cdm->dpm", a.rows, metric)
        for j, b in enumerate(touched):
            products = jnp.einsum("cpm,cqm->mpq", left, b.rows)
            if a.in_border and b.in_border:
                where = a.at[:, :, None], b.at[:, None, :]
                sums = sums._replace(border=sums.border.at[where].add(products, mode="drop"))
            elif b.in_border:
                where = a.at[:, None, None], jnp.arange(products.shape[1])[:, None], b.at[:, None, :]
                sums = sums._replace(coupling=sums.coupling.at[where].add(products, mode="drop"))
            elif not a.in_border:
                same = (a.at == b.at)[:, None, None]
                sums = sums._replace(diagonal=sums.diagonal.at[a.at].add(jnp.where(same, products, 0.0)))
                if i != j and sums.pairs is not None:
                    lower = (a.at > b.at)[:, None, None]
                    sums = sums._replace(pairs=sums.pairs.at[pairs].add(jnp.where(lower, products, 0.0)))
    return sums


def group_rows(group: Group, unknowns: Unknowns, d_rotation: Rotations, columns: tuple[int, ...]) -> GroupRows:
    """Residuals and rows of a group of observations, times the square roots of their weights."""
    touches, index, weights = group.kind.touches, group.indices, group.weights
    touched = tuple(touched_values(unknowns, kind, i) for kind, i in zip(touches, index, strict=True))

    def residual(*touched: Any) -> tuple[Scalar, ...]:
        return group.kind.residuals(touched, tuple(group.values), tuple(group.constants))

    v, transposed = jax.vjp(residual, *touched)
    rows: list[list[Array]] = [[] for _ in touches]
    for k in range(len(v)):
        if weights.ndim == 3:
            cotangent = tuple(weights[k])
        else:
            cotangent = tuple(weights[j] if j == k else jnp.zeros_like(weights[j]) for j in range(len(v)))
        for entity, (kind, g) in enumerate(zip(touches, transposed(cotangent), strict=True)):
            if kind == "image":
                turned = d_rotation[:, :, index[entity]]
                g = (*g[0], *(chained(g[1], tuple(turned[:, a])) for a in range(3)))
            elif kind == "camera":
                g = tuple(g[column] for column in columns)
            elif kind == "parameter":
                g = (g,)
            rows[entity].append(jnp.stack(g) if g else jnp.zeros((0, group.values.shape[1])))
    return GroupRows(weighted(jnp.stack(v), group), tuple(jnp.stack(row) for row in rows))


def touched_by_group(group: Group, rows: tuple[Array, ...], p: Problem) -> list[Touched]:
    """Positions of the rows of a group; all rows of the border are combined."""
    touched, border = [], []
    for kind, index, row in zip(group.kind.touches, group.indices, rows, strict=True):
        if kind == "image":
            touched.append(Touched(_in_image(row, 0, p), False, index))
        elif kind == "camera" and p.layout.own_cameras:  # cameras of single images are in the order of their images
            touched.append(Touched(_in_image(row, EXTERIOR, p), False, index))
        else:
            border.append((row, _border_rows(kind, index, p)))
    if border:
        rows_there, at = zip(*border, strict=True)
        touched.append(Touched(jnp.concatenate(rows_there, 1), True, jnp.concatenate(at, 1)))
    return touched


def _in_image(rows: Array, first: int, p: Problem) -> Array:
    """Rows of some elements of an image's block as rows of the whole block."""
    return jnp.pad(rows, ((0, 0), (first, p.layout.image - first - rows.shape[1]), (0, 0)))


def _border_rows(kind: str, index: Array, p: Problem) -> Int[Array, "member parameter"]:
    """Rows of an entity in the border; outside for an eliminated point."""
    layout = p.layout
    if kind == "point":
        inside = (index >= p.tile_points)[:, None]
        return jnp.where(inside, layout.point_rows(index - p.tile_points), layout.border)
    return layout.first_parameter + index[:, None] if kind == "parameter" else layout.camera_rows(index)


def add_group(sums: ReducedSums, group: Group, rows: GroupRows, pairs: Array | None, p: Problem) -> ReducedSums:
    """Adds the rows of a group for images and border, without eliminated points."""
    return add_rows(sums, touched_by_group(group, rows.rows, p), rows.residuals, pairs)


def add_point_terms(
    terms: Float[Array, "9 point"] | None, group: Group, rows: GroupRows
) -> Float[Array, "9 point"] | None:
    """Adds a group that touches one eliminated point per member to V (6 numbers) and gradient of the points."""
    if terms is None or group.kind.touches != ("point",):
        return terms
    b = rows.rows[0]
    added = [jnp.sum(b[:, i] * b[:, j], 0) for i, j in PAIRS]
    added += [jnp.sum(b[:, i] * rows.residuals, 0) for i in range(3)]
    return terms.at[:, group.indices[0]].add(jnp.stack(added), mode="drop")


def add_border_rays(sums: ReducedSums, unknowns: Unknowns, d_rotation: Rotations, p: Problem) -> ReducedSums:
    """Adds the rays of border points; `unknowns.points` are the border points."""
    return add_rows(sums, *border_ray_rows(unknowns, d_rotation, p), None) if p.border_rays else sums


def border_rays(unknowns: Unknowns, d_rotation: Rotations, p: Problem) -> Ray:
    """The rays of border points; a ray without weight has a point in front of its camera."""
    rays = p.border_rays
    turned = d_rotation[:, :, rays.image]
    centre, rotation = tuple(unknowns.centre[:, rays.image]), tuple(unknowns.rotation[:, rays.image])
    ahead = [x - r for x, r in zip(centre, rotation[2::3], strict=True)]
    used = is_used(rays.weights)
    x, y, z = (jnp.where(used, x, s) for x, s in zip(unknowns.points[:, rays.point], ahead, strict=True))
    image = ImageScalars(
        rotation,
        (tuple(turned[:, 0]), tuple(turned[:, 1]), tuple(turned[:, 2])),
        (centre[0], centre[1], centre[2]),
        tuple(unknowns.interior[:, p.observations.image_camera[rays.image]]),
    )
    return Ray(image, (x, y, z), tuple(rays.measured), tuple(rays.weights))


def border_ray_rows(
    unknowns: Unknowns, d_rotation: Rotations, p: Problem
) -> tuple[list[Touched], Float[Array, "component ray"]]:
    """Weighted rows and residuals of the rays of border points."""
    rows = ray_rows(p.observations, border_rays(unknowns, d_rotation, p))
    of_image = jnp.stack([jnp.stack(row) for row in rows.image])
    of_point = jnp.stack([jnp.stack(row) for row in rows.point])
    return touched_by_rays(of_image, of_point, p), jnp.stack(rows.residual)


def touched_by_rays(
    of_image: Float[Array, "component unknown ray"], of_point: Float[Array, "component 3 ray"], p: Problem
) -> list[Touched]:
    """Positions of the rows of the rays of border points."""
    layout, rays = p.layout, p.border_rays
    touched = [
        Touched(of_image[:, : layout.image], False, rays.image),
        Touched(of_point, True, layout.point_rows(rays.point)),
    ]
    if layout.shared:
        camera = p.observations.image_camera[rays.image]
        touched.append(Touched(of_image[:, layout.image :], True, layout.camera_rows(camera)))
    return touched
