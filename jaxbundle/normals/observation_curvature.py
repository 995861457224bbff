"""Second derivatives of v^T P v / 2 of observations and rays that touch more than one eliminated point.

Each is a function of the small corrections of its touched entities, with

    R(alpha, omega, kappa) = R + sum of dR/da a + half the sum of d2R/da db a b

and its second derivatives are added to the same blocks as the products of its rows.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Group, touched_values, weighted
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals.observation_rows import add_products, border_rays, touched_by_group, touched_by_rays
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.point_blocks import PAIRS
from jaxbundle.normals.problem import OrderedUnknowns, Problem, ReducedSums
from jaxbundle.normals.rows import image_equation

Residual = Callable[[Float[Array, "parameter member"]], Float[Array, "component member"]]
PointTerms = Float[Array, "9 point"]


class Rotations(NamedTuple):
    """First and second derivatives of the rotation matrices of some images."""

    first: Float[Array, "9 3 member"]
    second: Float[Array, "9 3 3 member"]

    def of(self, image: Array) -> "Rotations":
        """The derivatives of selected images."""
        return Rotations(self.first[:, :, image], self.second[..., image])

    def turned(self, rotation: Float[Array, "9 member"], angles: Float[Array, "3 member"]) -> Float[Array, "9 member"]:
        """The matrices after small rotations."""
        bent = jnp.einsum("eabm,am,bm->em", self.second, angles, angles)
        return rotation + jnp.einsum("eam,am->em", self.first, angles) + 0.5 * bent


def add_curvature(
    sums: ReducedSums,
    point_terms: PointTerms | None,
    unknowns: OrderedUnknowns,
    rotations: Rotations,
    p: Problem,
) -> tuple[ReducedSums, PointTerms | None]:
    """Adds the second derivatives to the sums and to the equations of single eliminated points."""
    o = p.observations
    if p.border_rays:
        sums = _add_rays(sums, unknowns.images, rotations, p)
    flat = unknowns.flat() if o.groups else unknowns.images
    for group, pairs in zip(o.groups, p.group_pairs, strict=True):
        sizes = [_size(kind, len(o.columns)) for kind in group.kind.touches]
        members = group.values.shape[1]
        curvature = _curvature(_group_residual(group, flat, rotations, o.columns), sum(sizes), members)
        touched = touched_by_group(group, tuple(_units(sizes, members)), p)
        sums = add_products(sums, touched, curvature, pairs)
        if group.kind.touches == ("point",) and point_terms is not None:
            terms = jnp.stack([curvature[i, j] for i, j in PAIRS])
            point_terms = point_terms.at[:6, group.indices[0]].add(terms, mode="drop")
    return sums, point_terms


def _size(kind: str, columns: int) -> int:
    """The corrections of one entity."""
    return {"image": EXTERIOR, "point": 3, "camera": columns, "parameter": 1}[kind]


def _units(sizes: list[int], members: int) -> list[Float[Array, "all own member"]]:
    """Selection matrix of the corrections of one entity."""
    ends = np.cumsum(sizes)
    own = np.split(np.eye(sum(sizes)), ends[:-1], axis=1)
    return [jnp.broadcast_to(unit[:, :, None], (*unit.shape, members)) for unit in own]


def _curvature(residual: Residual, parameters: int, members: int) -> Float[Array, "parameter parameter member"]:
    """The sum of w^2 v d2v over the components; `residual` is w v."""
    none = jnp.zeros((parameters, members))
    constant = residual(none)
    gradient = jax.grad(lambda d: jnp.sum(constant * residual(d)))
    units = jnp.broadcast_to(jnp.eye(parameters)[:, :, None], (parameters, parameters, members))
    return jax.vmap(lambda unit: jax.jvp(gradient, (none,), (unit,))[1])(units)


def _group_residual(group: Group, unknowns: Unknowns, rotations: Rotations, columns: tuple[int, ...]) -> Residual:
    """Weighted residuals of a group as a function of the corrections of the touched entities."""
    ends = np.cumsum([_size(kind, len(columns)) for kind in group.kind.touches])

    def corrected(kind: str, index: Array, d: Array) -> Any:
        value = touched_values(unknowns, kind, index)
        if kind == "image":
            rotation = rotations.of(index).turned(jnp.stack(value[1]), d[3:])
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


def _add_rays(sums: ReducedSums, unknowns: Unknowns, rotations: Rotations, p: Problem) -> ReducedSums:
    """The rays of border points."""
    o, elements, members = p.observations, len(p.observations.columns), p.border_rays.image.shape[0]
    ray, own = border_rays(unknowns, rotations.first, p), rotations.of(p.border_rays.image)
    image = ray.image

    def residual(d: Float[Array, "parameter member"]) -> Float[Array, "component member"]:
        centre, angles, interior, of_point = jnp.split(d, [3, EXTERIOR, EXTERIOR + elements])
        rotation = tuple(own.turned(jnp.stack(image.rotation), angles))
        estimated = tuple(jnp.stack(image.interior).at[np.array(o.columns, int)].add(interior))
        at, x = (tuple(jnp.stack(v) + c) for v, c in ((image.centre, centre), (ray.point, of_point)))
        there = rotation, (at[0], at[1], at[2]), estimated
        v = image_equation(o.model, there, (x[0], x[1], x[2]), ray.measured)
        return jnp.stack(v) * p.border_rays.weights

    of_image, of_point = _units([EXTERIOR + elements, 3], members)
    touched = touched_by_rays(of_image, of_point, p)
    return add_products(sums, touched, _curvature(residual, EXTERIOR + elements + 3, members), None)
