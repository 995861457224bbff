"""Least-squares orientation of two photographs: both rays of a point and the base are in one plane.

    F = B . (d1 x R d2) = 0          d1, d2 photo vectors (a, b, -1), R model_from_second, B the base in the model

The first photograph has no rotation and is at the origin of the model. With covariances C1, C2 of (a, b) and

    g1 = dF/dd1 = R d2 x B,     g2 = dF/dd2 = R^T (B x d1),     sigma_F^2 = g1^T C1 g1 + g2^T C2 g2

r = F / sigma_F is the y-parallax in units of its standard deviation (Foerstner, Wrobel 2016, ch. 13.3). The sum of r^2,
with sigma_F and its derivative updated in each iteration, has the minimum of the bundle of two photographs. The
unknowns are a small rotation and two tangents of the unit vector B, so that no attitude and no direction of the base is
singular.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxbundle.geometry.rotation import from_rotation_vector

UNKNOWNS = 5
TINY = 1e-300
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-12, 1e8
REJECTED = 3.0  # limit in standard deviations of a y-parallax


class Rays(NamedTuple):
    """Photo vectors (a, b, -1) of common points, covariances of (a, b), and a mask of the used points."""

    first: Float[Array, "point 3"]
    second: Float[Array, "point 3"]
    first_covariance: Float[Array, "point 2 2"]
    second_covariance: Float[Array, "point 2 2"]
    valid: Bool[Array, " point"]


class Pair(NamedTuple):
    """Rotation model_from_second and the unit vector from the first to the second projection centre."""

    rotation: Float[Array, "3 3"]
    base: Float[Array, "3"]


def changed(at: Pair, d: Float[Array, "5"]) -> Pair:
    """The orientation after corrections."""
    turn = jnp.stack(from_rotation_vector(d[0], d[1], d[2])).reshape(3, 3)
    across = jnp.cross(at.base, jnp.eye(3)[jnp.argmin(jnp.abs(at.base))])
    across = across / jnp.linalg.norm(across)
    base = at.base + d[3] * across + d[4] * jnp.cross(at.base, across)
    return Pair(turn @ at.rotation, base / jnp.linalg.norm(base))


def gradients(at: Pair, rays: Rays) -> tuple[Float[Array, " point"], Float[Array, "point 2"], Float[Array, "point 2"]]:
    """The condition F and its derivatives with respect to a and b in both photographs."""
    turned = rays.second @ at.rotation.T
    g1 = jnp.cross(turned, at.base)
    g2 = jnp.cross(at.base, rays.first) @ at.rotation
    return jnp.sum(rays.first * g1, 1), g1[:, :2], g2[:, :2]


def variances(g1: Array, g2: Array, rays: Rays) -> Float[Array, " point"]:
    """The variances sigma_F^2 of the conditions."""
    one = jnp.einsum("pi,pij,pj->p", g1, rays.first_covariance, g1)
    return one + jnp.einsum("pi,pij,pj->p", g2, rays.second_covariance, g2)


def parallaxes(at: Pair, rays: Rays) -> Float[Array, " point"]:
    """The residual r = F / sigma_F, 0 for unused points."""
    f, g1, g2 = gradients(at, rays)
    variance = variances(g1, g2, rays)
    usable = rays.valid & (variance > TINY)
    return jnp.where(usable, f / jnp.sqrt(jnp.where(usable, variance, 1.0)), 0.0)


class Loss(NamedTuple):
    """A loss function and the weights of the normal equations, as functions of r^2."""

    value: Callable[[Array], Array]
    weight: Callable[[Array], Array]


CAUCHY = Loss(lambda s: 4 * jnp.log1p(s / 4), lambda s: 1 / (1 + s / 4))


def squares(used: Bool[Array, " point"]) -> Loss:
    """The sum of squares of the used points."""
    return Loss(lambda s: jnp.where(used, s, 0.0), lambda s: jnp.where(used, 1.0, 0.0) + 0 * s)


def normal_equations(at: Pair, rays: Rays, loss: Loss) -> tuple[Array, Array, Array, Array]:
    """The loss, N, the right-hand side and the rows of r."""
    value = lambda d: parallaxes(changed(at, d), rays)  # noqa: E731
    r, a = value(jnp.zeros(UNKNOWNS)), jax.jacfwd(value)(jnp.zeros(UNKNOWNS))
    weighted = a * loss.weight(r * r)[:, None]
    return jnp.sum(loss.value(r * r)), weighted.T @ a, weighted.T @ r, a


def refined(start: Pair, rays: Rays, loss: Loss, steps: int) -> tuple[Pair, Float[Array, ""]]:
    """The orientation after Levenberg-Marquardt steps, and the size of the last accepted step."""

    def step(_: Array, state: tuple) -> tuple:
        at, (cost, normals, right), damping, size = state
        diagonal = jnp.diagonal(normals)
        damped = normals + jnp.diag(damping * diagonal + 1e-15 * jnp.max(diagonal) + TINY)
        d = -jnp.linalg.solve(damped, right)
        d = d / jnp.maximum(1.0, 2 * jnp.max(jnp.abs(d)))  # steps are limited to half a radian
        trial = changed(at, d)
        new = normal_equations(trial, rays, loss)[:3]
        accepted = new[0] <= cost * (1 + 1e-13) + 1e-25
        at, equations = jax.tree.map(lambda x, y: jnp.where(accepted, x, y), (trial, new), (at, state[1]))
        factor = jnp.where(accepted, 0.1, 10.0)
        size = jnp.where(accepted, jnp.max(jnp.abs(d)), size)
        return at, equations, jnp.clip(damping * factor, MIN_DAMPING, MAX_DAMPING), size

    state = start, normal_equations(start, rays, loss)[:3], jnp.asarray(FIRST_DAMPING), jnp.asarray(jnp.inf)
    at, _, _, size = lax.fori_loop(0, steps, step, state)
    return at, size


def corrected(at: Pair, rays: Rays) -> tuple[Float[Array, "point 3"], Float[Array, "point 3"]]:
    """The photo vectors after their least-squares corrections, coplanar with the base to first order."""
    f, g1, g2 = gradients(at, rays)
    variance = variances(g1, g2, rays)
    factor = (f / jnp.where(variance > TINY, variance, jnp.inf))[:, None]

    def moved(ray: Array, covariance: Array, g: Array) -> Array:
        return ray.at[:, :2].add(-factor * jnp.einsum("pij,pj->pi", covariance, g))

    return moved(rays.first, rays.first_covariance, g1), moved(rays.second, rays.second_covariance, g2)


def model_points(at: Pair, rays: Rays) -> Float[Array, "point 3"]:
    """Intersections of the corrected rays; the base has length 1."""
    first, second = corrected(at, rays)
    turned = second @ at.rotation.T
    normal = jnp.cross(first, turned)
    squared = jnp.sum(normal**2, 1)
    squared = jnp.where(squared > TINY, squared, jnp.nan)
    one = jnp.sum(jnp.cross(at.base, turned) * normal, 1) / squared
    two = jnp.sum(jnp.cross(at.base, first) * normal, 1) / squared
    return 0.5 * (one[:, None] * first + at.base[None] + two[:, None] * turned)
