"""Second derivatives of v^T P v / 2 by observations and rays that touch more than one eliminated point.

Each is a function of the small corrections of all it touches, with

    R(alpha, omega, kappa) = R + sum of dR/da a + half the sum of d2R/da db a b

and its second derivatives go to where the products of its rows go.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Group, touched_values, weighted
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals.arrange import Problem
from jaxbundle.normals.eliminate import PAIRS
from jaxbundle.normals.kept import KeptSums, add_products, kept_ray_values, touched_by_group, touched_by_rays
from jaxbundle.normals.rows import GroupRows, image_equation

Residual = Callable[[Float[Array, "parameter member"]], Float[Array, "component member"]]


def add_curvature(
    sums: KeptSums,
    prior: Float[Array, "9 place"] | None,
    unknowns: Unknowns,
    flat: Unknowns,
    turns: Float[Array, "9 3 image"],
    bends: Float[Array, "9 3 3 image"],
    p: Problem,
) -> tuple[KeptSums, Float[Array, "9 place"] | None]:
    """Adds the second derivatives. `unknowns` has the kept points, `flat` all of them; `turns` and `bends`: first and
    second derivatives of the rotation matrices."""
    o, shape = p.observations, p.shape
    if p.kept_rays.image.shape[0]:
        sums = _add_rays(sums, unknowns, turns, bends, p)
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        sizes = [_size(kind, len(o.columns)) for kind in group.kind.touches]
        curvature = _curvature(_group_residual(group, flat, turns, bends, o.columns), sum(sizes), group.values.shape[1])
        units = _units(sizes, group.values.shape[1])
        rows = GroupRows(group.values, tuple(units))
        touched = touched_by_group(group, rows, shape, p.point_column, p.camera_image)
        sums = add_products(sums, touched, curvature, pairs)
        if group.kind.touches == ("point",) and prior is not None:
            terms = jnp.stack([curvature[i, j] for i, j in PAIRS])
            prior = prior.at[:6, group.indices[0]].add(terms, mode="drop")
    return sums, prior


def _size(kind: str, columns: int) -> int:
    """Corrections of an entity."""
    return {"image": 6, "point": 3, "camera": columns, "parameter": 1}[kind]


def _units(sizes: list[int], members: int) -> list[Float[Array, "all own member"]]:
    """Which of all corrections are an entity's own."""
    ends = np.cumsum(sizes)
    own = np.split(np.eye(sum(sizes)), ends[:-1], axis=1)
    return [jnp.broadcast_to(unit[:, :, None], (*unit.shape, members)) for unit in own]


def _curvature(residual: Residual, parameters: int, members: int) -> Float[Array, "parameter parameter member"]:
    """Sum over the components of w^2 v d2v; `residual` is w v."""
    none = jnp.zeros((parameters, members))
    held = residual(none)
    gradient = jax.grad(lambda d: jnp.sum(held * residual(d)))
    units = jnp.eye(parameters)[:, :, None] * jnp.ones(members)
    return jax.vmap(lambda unit: jax.jvp(gradient, (none,), (unit,))[1])(units)


def _turned(
    rotation: Float[Array, "9 member"],
    turns: Float[Array, "9 3 member"],
    bends: Float[Array, "9 3 3 member"],
    angles: Float[Array, "3 member"],
) -> Float[Array, "9 member"]:
    return (
        rotation + jnp.einsum("eam,am->em", turns, angles) + 0.5 * jnp.einsum("eabm,am,bm->em", bends, angles, angles)
    )


def _group_residual(
    group: Group,
    unknowns: Unknowns,
    turns: Float[Array, "9 3 image"],
    bends: Float[Array, "9 3 3 image"],
    columns: tuple[int, ...],
) -> Residual:
    """Weighted residuals of a group as a function of the corrections of what its members touch."""
    ends = np.cumsum([_size(kind, len(columns)) for kind in group.kind.touches])

    def corrected(kind: str, index: Array, d: Array) -> Any:
        value = touched_values(unknowns, kind, index)
        if kind == "image":
            rotation = _turned(jnp.stack(value[1]), turns[:, :, index], bends[..., index], d[3:])
            return tuple(x + c for x, c in zip(value[0], d[:3], strict=True)), tuple(rotation)
        if kind == "camera":
            return tuple(jnp.stack(value).at[np.array(columns, int)].add(d))
        return value + d[0] if kind == "parameter" else tuple(x + c for x, c in zip(value, d, strict=True))

    def residual(d: Float[Array, "parameter member"]) -> Float[Array, "component member"]:
        parts = zip(group.kind.touches, group.indices, jnp.split(d, ends[:-1]), strict=True)
        touched = tuple(corrected(kind, index, part) for kind, index, part in parts)
        v = group.kind.residuals(touched, tuple(group.values), tuple(group.constants))
        return weighted(jnp.stack(v), group)

    return residual


def _add_rays(
    sums: KeptSums, unknowns: Unknowns, turns: Float[Array, "9 3 image"], bends: Float[Array, "9 3 3 image"], p: Problem
) -> KeptSums:
    """The rays of kept points."""
    o, rays, elements = p.observations, p.kept_rays, len(p.observations.columns)
    image, point = kept_ray_values(rays, unknowns, turns, o)
    bend, members = bends[..., rays.image], rays.image.shape[0]
    turn = jnp.stack([jnp.stack(t) for t in image.rotation_derivatives], 1)

    def residual(d: Float[Array, "parameter member"]) -> Float[Array, "2 member"]:
        centre, angles, interior, moved = jnp.split(d, [3, 6, 6 + elements])
        rotation = tuple(_turned(jnp.stack(image.rotation), turn, bend, angles))
        estimated = tuple(jnp.stack(image.interior).at[np.array(o.columns, int)].add(interior))
        at, x = (tuple(jnp.stack(v) + c) for v, c in ((image.centre, centre), (point, moved)))
        measured = rays.measured[0], rays.measured[1]
        v = image_equation(o.model, rotation, (at[0], at[1], at[2]), estimated, (x[0], x[1], x[2]), measured)
        return jnp.stack(v) * rays.weights

    of_image, of_point = _units([6 + elements, 3], members)
    touched = touched_by_rays(rays, of_image, of_point, o, p.shape)
    return add_products(sums, touched, _curvature(residual, 9 + elements, members), None)
