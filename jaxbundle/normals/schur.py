"""Elimination of the object points (Schur complement).

    [ U    W ] [dt]     [g_t]         V = L L^T   3 x 3 a point
    [ W^T  V ] [dX] = - [g_X]         E = L^-1 W^T,  z = L^-1 g_X

    (U + lambda D_t - E^T E) dt = -g_t + E^T z          D = diag(N), Marquardt's scaling; V carries lambda D_X
    dX = -L^-T (z + E dt)

The Jacobian is never stored: points are taken a chunk at a time and their rows formed where they are used.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxbundle.block.residuals import Observations, ray_residuals, weighted_residuals
from jaxbundle.block.unknowns import Correction, Unknowns, attitude_derivatives
from jaxbundle.normals.plan import Plan
from jaxbundle.normals.point_blocks import PointFactor, backward, factorise, forward
from jaxbundle.normals.rows import ImageScalars, RayRows, group_rows, ray_rows

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Eliminated(NamedTuple):
    """The reduced normal equations before damping, and what back-substitution needs of the points."""

    reduced: Float[Array, "kept kept"]  # U - E^T E
    diagonal: Float[Array, " kept"]  # of U
    gradient: Float[Array, " kept"]
    right: Float[Array, " kept"]  # -g_t + E^T z
    factor: Float[Array, "6 point"]
    point_gradient: Float[Array, "3 point"]
    point_diagonal: Float[Array, "3 point"]  # of V before damping


class Tables(NamedTuple):
    """What every ray of an image shares."""

    derivatives: Float[Array, "9 3 image"]
    unknowns: Unknowns
    observations: Observations


def tables(unknowns: Unknowns, observations: Observations) -> Tables:
    """Rotation derivatives of all images, formed once a linearisation."""
    turns = attitude_derivatives(unknowns.rotation, observations.in_angles, observations.system)
    return Tables(turns, unknowns, observations)


def rows_of(t: Tables, ray: Array, used: Array) -> RayRows:
    """Rows of some rays; a slot that is not used has weight 0."""
    o, u = t.observations, t.unknowns
    image, point = o.ray_image[ray], o.ray_point[ray]
    turns = t.derivatives[:, :, image]
    scalars = ImageScalars(
        tuple(u.rotation[:, image]),
        (tuple(turns[:, 0]), tuple(turns[:, 1]), tuple(turns[:, 2])),
        tuple(u.centre[:, image]),
        tuple(u.interior[:, o.image_camera[image]]),
    )
    weights = jnp.where(used, o.weights[:, ray], 0.0)
    x, y = o.coordinates[:, ray]
    return ray_rows(o.model, o.columns, scalars, tuple(u.points[:, point]), (x, y), (weights[0], weights[1]))


def ray_columns(t: Tables, ray: Array) -> Array:
    """Columns of the reduced matrix that a ray touches, (ray, 6 + interior)."""
    o = t.observations
    image = o.ray_image[ray]
    q = len(o.columns)
    first = 6 * o.exterior_free.shape[1] + q * o.image_camera[image]
    return jnp.concatenate([6 * image[:, None] + jnp.arange(6), first[:, None] + jnp.arange(q)], 1)


def free_columns(observations: Observations, plan: Plan) -> Bool[Array, " kept"]:
    """Which kept elements are unknown."""
    o = observations
    return jnp.concatenate(
        [o.exterior_free.T.ravel(), o.interior_free.T.ravel(), o.point_free[:, plan.kept_point].T.ravel()]
    )


class _Sums(NamedTuple):
    """Running sums over rays and groups; one column and one point more than there are catch what is not wanted."""

    normals: Float[Array, "column column"]
    gradient: Float[Array, " column"]

    def add(self, columns: Array, rows: Array, residuals: Array) -> "_Sums":
        """Adds rows (component, parameter, member) with their columns (member, parameter)."""
        products = jnp.einsum("cpm,cqm->mpq", rows, rows)
        return _Sums(
            self.normals.at[columns[:, :, None], columns[:, None, :]].add(products),
            self.gradient.at[columns].add(jnp.einsum("cpm,cm->mp", rows, residuals)),
        )


def _groups(t: Tables, plan: Plan, sums: _Sums, points: Array) -> tuple[_Sums, Array]:
    """Adds all observations that are no rays; those of one eliminated point go into `points` (9, point + 1)."""
    o = t.observations
    dump = plan.size
    for group in o.groups:
        residuals, rows = group_rows(group, t.unknowns, t.derivatives, o.columns)
        columns = []
        for kind, index, row in zip(group.kind.touches, group.indices, rows, strict=True):
            first = {
                "image": 6 * index,
                "camera": 6 * o.exterior_free.shape[1] + len(o.columns) * index,
                "point": plan.point_column[index],
            }[kind]
            columns.append(jnp.minimum(first[:, None] + jnp.arange(row.shape[1]), dump))
        sums = sums.add(jnp.concatenate(columns, 1), jnp.concatenate(rows, 1), residuals)
        if group.kind.touches == ("point",):
            b = rows[0]
            v = [jnp.sum(b[:, i] * b[:, j], 0) for i, j in PAIRS]
            g = [jnp.sum(b[:, i] * residuals, 0) for i in range(3)]
            points = points.at[:, group.indices[0]].add(jnp.stack(v + g))
    return sums, points


def _kept_rays(t: Tables, plan: Plan, sums: _Sums) -> _Sums:
    """Adds the rays of points that are not eliminated."""
    if plan.kept_ray.shape[0] == 0:
        return sums
    rows = rows_of(t, plan.kept_ray, jnp.ones(plan.kept_ray.shape, bool))
    first = plan.point_column[t.observations.ray_point[plan.kept_ray]]
    columns = jnp.concatenate([ray_columns(t, plan.kept_ray), first[:, None] + jnp.arange(3)], 1)
    design = jnp.stack([jnp.stack([*rows.image[k], *rows.point[k]]) for k in range(2)])
    return sums.add(columns, design, jnp.stack(rows.residual))


class Chunk(NamedTuple):
    """One chunk of points eliminated: E (three rows a point), factors, gradient and diagonal of its points."""

    coupling: Float[Array, "row column"]
    factor: PointFactor
    point: Array
    gradient: Array
    diagonal: Array
    rows: RayRows


def eliminate_chunk(t: Tables, plan: Plan, points: Array, damping: Array, c: Array) -> Chunk:
    """Factorises the points of chunk `c` and forms E. `points`: V and gradient from other observations."""
    ray, used, place, point = plan.ray[c], plan.used[c], plan.place[c], plan.point[c]
    rows = rows_of(t, ray, used)
    (bx, by), (vx, vy) = rows.point, rows.residual
    terms = [bx[i] * bx[j] + by[i] * by[j] for i, j in PAIRS] + [bx[i] * vx + by[i] * vy for i in range(3)]
    n = point.shape[0]
    sums = jax.ops.segment_sum(jnp.stack(terms, 1), place, n).T + points[:, point]
    free = tuple(jnp.concatenate([t.observations.point_free, jnp.zeros((3, 1), bool)], 1)[:, point])
    damped = [sums[k] * (1 + damping) if k in (0, 3, 5) else sums[k] for k in range(6)]
    factor = factorise(tuple(damped), free)
    at_ray = PointFactor(*(f[place] for f in factor))
    hx, hy = forward(at_ray, bx), forward(at_ray, by)
    blocks = jnp.stack(
        [jnp.stack([a * hx[k] + b * hy[k] for a, b in zip(*rows.image, strict=True)], 1) for k in range(3)], 1
    )
    coupling = jnp.zeros((3 * n, plan.size + 1))
    index = (3 * place[:, None] + jnp.arange(3))[:, :, None], ray_columns(t, ray)[:, None, :]
    return Chunk(coupling.at[index].add(blocks), factor, point, sums[6:], sums[jnp.array([0, 3, 5])], rows)


def eliminate(t: Tables, plan: Plan, damping: Array) -> Eliminated:
    """The reduced normal equations, the points eliminated with `damping` times the diagonal of V added."""
    size, points = plan.size, t.observations.point_free.shape[1]
    sums = _Sums(jnp.zeros((size + 1, size + 1)), jnp.zeros(size + 1))
    sums, point_sums = _groups(t, plan, sums, jnp.zeros((9, points + 1)))
    sums = _kept_rays(t, plan, sums)

    def add_chunk(c: Array, carry: tuple) -> tuple:
        sums, complement, right, store = carry
        chunk = eliminate_chunk(t, plan, point_sums, damping, c)
        design = jnp.stack([jnp.stack(a) for a in chunk.rows.image])
        sums = sums.add(ray_columns(t, plan.ray[c]), design, jnp.stack(chunk.rows.residual))
        z = jnp.stack(forward(chunk.factor, tuple(chunk.gradient)), 1).ravel()
        store = store.at[:, chunk.point].set(jnp.concatenate([jnp.stack(chunk.factor), chunk.gradient, chunk.diagonal]))
        return sums, complement + chunk.coupling.T @ chunk.coupling, right + z @ chunk.coupling, store

    start = sums, jnp.zeros((size + 1, size + 1)), jnp.zeros(size + 1), jnp.zeros((12, points + 1))
    sums, complement, right, store = lax.fori_loop(0, plan.ray.shape[0], add_chunk, start)
    store = store[:, :points]
    return Eliminated(
        (sums.normals - complement)[:size, :size],
        jnp.diagonal(sums.normals)[:size],
        sums.gradient[:size],
        (right - sums.gradient)[:size],
        store[:6],
        store[6:9],
        store[9:],
    )


class Step(NamedTuple):
    """A correction and what the search and the stopping rules need of it; cost = v^T P v / 2."""

    correction: Correction
    gradient_step: Float[Array, ""]  # g . d
    damped_step: Float[Array, ""]  # d . lambda D d
    finite: Bool[Array, ""]


def tangent(t: Tables, plan: Plan, kept: Float[Array, " kept"]) -> tuple[Correction, Unknowns]:
    """A step of the kept unknowns as a correction, and as a direction in the space of the unknowns."""
    o, u = t.observations, t.unknowns
    images, cameras, q = o.exterior_free.shape[1], o.interior_free.shape[1], len(o.columns)
    exterior = kept[: 6 * images].reshape(images, 6).T
    by_column = kept[6 * images : 6 * images + q * cameras].reshape(cameras, q).T
    interior = jnp.zeros_like(u.interior).at[np.array(o.columns, int)].set(by_column)
    by_point = kept[6 * images + q * cameras :].reshape(-1, 3).T
    points = jnp.zeros_like(u.points).at[:, plan.kept_point].set(by_point)
    turned = sum(t.derivatives[:, k] * exterior[3 + k] for k in range(3))
    return Correction(exterior, interior, points), Unknowns(turned, exterior[:3], interior, points)


def back_substitute(t: Tables, plan: Plan, e: Eliminated, damping: Array, kept: Float[Array, " kept"]) -> Step:
    """The corrections of the eliminated points, and the scalars of the whole step."""
    o, u = t.observations, t.unknowns
    correction, direction = tangent(t, plan, kept)
    _, along = jax.jvp(lambda x: ray_residuals(x, o), (u,), (direction,))
    at_points = lambda x: ray_residuals(Unknowns(u.rotation, u.centre, u.interior, x), o)  # noqa: E731
    (coupled,) = jax.vjp(at_points, u.points)[1](along * o.weights**2)
    factor = PointFactor(*e.factor)
    y = forward(factor, tuple(e.point_gradient + coupled))
    eliminated = -jnp.stack(backward(factor, y))
    gradient_step = jnp.dot(e.gradient, kept) + jnp.sum(e.point_gradient * eliminated)
    damped_step = damping * (jnp.dot(e.diagonal, kept**2) + jnp.sum(e.point_diagonal * eliminated**2))
    finite = jnp.all(jnp.isfinite(kept)) & jnp.all(jnp.isfinite(eliminated))
    correction = eqx.tree_at(lambda c: c.points, correction, correction.points + eliminated)
    return Step(correction, gradient_step, damped_step, finite)


def cost(unknowns: Unknowns, observations: Observations) -> Float[Array, ""]:
    """v^T P v / 2 of all observations."""
    return 0.5 * sum(jnp.sum(v * v) for v in weighted_residuals(unknowns, observations))
