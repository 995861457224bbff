"""Observations and rays that touch more than one eliminated point: their part of the reduced normal equations.

Their unknowns are rows of the images' blocks (exterior orientation, and the interior of an image's own camera) or of
the border (interior of shared cameras, parameters, then kept points):

    [ S_II  S_Ib ]     S_II  blocks d x d of pairs of images: diagonal ones apart, the others in the pool
    [       S_bb ]     S_Ib  d rows an image, S_bb dense
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Group, Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import Vector
from jaxbundle.normals.eliminate import PAIRS, Shape
from jaxbundle.normals.rows import GroupRows, ImageScalars, group_rows, ray_rows


class KeptRays(eqx.Module):
    """Rays of points that are not eliminated; padded with rays of weight 0. `point` counts the kept points."""

    image: Int[Array, " ray"]
    point: Int[Array, " ray"]
    measured: Float[Array, "2 ray"]
    weights: Float[Array, "2 ray"]


class KeptSums(NamedTuple):
    """Normal equations of the kept unknowns; `pool` is None where no observation touches two images."""

    diagonal: Float[Array, "image d d"]
    gradient: Float[Array, "image d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    border_gradient: Float[Array, " border"]
    pool: Float[Array, "pair d d"] | None


class Touched(NamedTuple):
    """Rows (component, parameter, member) of one touched entity: in an image's block or in columns of the border."""

    rows: Float[Array, "component parameter member"]
    in_border: bool
    at: Int[Array, "member *parameter"]  # image of each member, or columns of the border


def no_sums(images: int, d: int, border: int, pool: int | None) -> KeptSums:
    """Sums of nothing."""
    return KeptSums(
        jnp.zeros((images, d, d)),
        jnp.zeros((images, d)),
        jnp.zeros((images, d, border)),
        jnp.zeros((border, border)),
        jnp.zeros(border),
        None if pool is None else jnp.zeros((pool, d, d)),
    )


def add_rows(
    sums: KeptSums, touched: list[Touched], residuals: Float[Array, "component member"], pairs: Array | None
) -> KeptSums:
    """Adds observations. `pairs`: the pool's block of the first two touched images, where they are two."""
    for a in touched:
        gradient = jnp.einsum("cpm,cm->mp", a.rows, residuals)
        if a.in_border:
            sums = sums._replace(border_gradient=sums.border_gradient.at[a.at].add(gradient, mode="drop"))
        else:
            sums = sums._replace(gradient=sums.gradient.at[a.at].add(gradient))
    return add_products(sums, touched, None, pairs)


def add_products(
    sums: KeptSums,
    touched: list[Touched],
    metric: Float[Array, "component component member"] | None,
    pairs: Array | None,
) -> KeptSums:
    """Adds the products of all rows with all others, A^T A, or A^T M A where there is a metric."""
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
                if i != j and sums.pool is not None:
                    lower = (a.at > b.at)[:, None, None]
                    sums = sums._replace(pool=sums.pool.at[pairs].add(jnp.where(lower, products, 0.0)))
    return sums


def _padded_rows(rows: Array, first: int, d: int) -> Array:
    """Rows of some elements of an image's block as rows of the whole block."""
    return jnp.pad(rows, ((0, 0), (first, d - first - rows.shape[1]), (0, 0)))


def _first_column(kind: str, index: Array, shape: Shape, point_column: Array) -> Int[Array, " member"]:
    """Where the unknowns of an entity begin in the border."""
    if kind == "point":
        return point_column[index]
    return shape.first_parameter + index if kind == "parameter" else shape.shared * index


def touched_by_group(
    group: Group, rows: GroupRows, shape: Shape, point_column: Array, camera_image: Array
) -> list[Touched]:
    """Where the rows of a group belong; all that goes into the border goes as one."""
    touched, border = [], []
    for kind, index, row in zip(group.kind.touches, group.indices, rows.rows, strict=True):
        if kind == "image":
            touched.append(Touched(_padded_rows(row, 0, shape.image), False, index))
        elif kind == "camera" and not shape.shared:
            touched.append(Touched(_padded_rows(row, 6, shape.image), False, camera_image[index]))
        else:
            first = _first_column(kind, index, shape, point_column)
            border.append((row, first[:, None] + jnp.arange(row.shape[1])))
    if border:
        rows_there, columns = zip(*border, strict=True)
        touched.append(Touched(jnp.concatenate(rows_there, 1), True, jnp.concatenate(columns, 1)))
    return touched


def add_group(
    sums: KeptSums,
    prior: Array | None,
    group: Group,
    pairs: Array | None,
    unknowns: Unknowns,
    turns: Float[Array, "9 3 image"],
    observations: Observations,
    shape: Shape,
    point_column: Array,
    camera_image: Array,
) -> tuple[KeptSums, Array | None]:
    """Adds a group of observations; what touches one eliminated point only goes into `prior` (9, place)."""
    rows = group_rows(group, unknowns, turns, observations.columns)
    sums = add_rows(sums, touched_by_group(group, rows, shape, point_column, camera_image), rows.residuals, pairs)
    if group.kind.touches == ("point",) and prior is not None:
        b = rows.rows[0]
        terms = [jnp.sum(b[:, i] * b[:, j], 0) for i, j in PAIRS]
        terms += [jnp.sum(b[:, i] * rows.residuals, 0) for i in range(3)]
        prior = prior.at[:, group.indices[0]].add(jnp.stack(terms), mode="drop")
    return sums, prior


def add_kept_rays(
    sums: KeptSums,
    rays: KeptRays,
    unknowns: Unknowns,
    turns: Float[Array, "9 3 image"],
    observations: Observations,
    shape: Shape,
) -> KeptSums:
    """Adds the rays of kept points; `unknowns.points` are the kept points."""
    if rays.image.shape[0] == 0:
        return sums
    return add_rows(sums, *kept_ray_rows(rays, unknowns, turns, observations, shape), None)


def kept_ray_values(
    rays: KeptRays, unknowns: Unknowns, turns: Float[Array, "9 3 image"], observations: Observations
) -> tuple[ImageScalars, Vector]:
    """What every ray of a kept point depends on; one without weight gets a point in front of its camera."""
    turn = turns[:, :, rays.image]
    centre = tuple(unknowns.centre[:, rays.image])
    rotation = tuple(unknowns.rotation[:, rays.image])
    used = (rays.weights[0] > 0) | (rays.weights[1] > 0)
    ahead = [x - r for x, r in zip(centre, rotation[2::3], strict=True)]
    point = [jnp.where(used, x, s) for x, s in zip(unknowns.points[:, rays.point], ahead, strict=True)]
    image = ImageScalars(
        rotation,
        (tuple(turn[:, 0]), tuple(turn[:, 1]), tuple(turn[:, 2])),
        (centre[0], centre[1], centre[2]),
        tuple(unknowns.interior[:, observations.image_camera[rays.image]]),
    )
    return image, (point[0], point[1], point[2])


def kept_ray_rows(
    rays: KeptRays,
    unknowns: Unknowns,
    turns: Float[Array, "9 3 image"],
    observations: Observations,
    shape: Shape,
) -> tuple[list[Touched], Float[Array, "2 ray"]]:
    """Weighted rows and residuals of the rays of kept points."""
    image, point = kept_ray_values(rays, unknowns, turns, observations)
    measured, weights = (rays.measured[0], rays.measured[1]), (rays.weights[0], rays.weights[1])
    rows = ray_rows(observations.model, observations.columns, image, point, measured, weights)
    of_image = jnp.stack([jnp.stack(row) for row in rows.image])
    of_point = jnp.stack([jnp.stack(row) for row in rows.point])
    return touched_by_rays(rays, of_image, of_point, observations, shape), jnp.stack(rows.residual)


def touched_by_rays(
    rays: KeptRays,
    of_image: Float[Array, "component unknown ray"],
    of_point: Float[Array, "component 3 ray"],
    observations: Observations,
    shape: Shape,
) -> list[Touched]:
    """Where the rows of the rays of kept points belong."""
    first = shape.first_kept_point + 3 * rays.point
    touched = [
        Touched(of_image[:, : shape.image], False, rays.image),
        Touched(of_point, True, first[:, None] + jnp.arange(3)),
    ]
    if shape.shared:
        camera = observations.image_camera[rays.image]
        columns = shape.shared * camera[:, None] + jnp.arange(shape.shared)
        touched.append(Touched(of_image[:, shape.image :], True, columns))
    return touched
