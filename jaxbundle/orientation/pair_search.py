"""The relative orientation of two images without approximate values: samples, candidates, and selection.

Samples of five rays give essential matrices, and their first four rays a homography. On flat ground two orientations
satisfy all coplanarity conditions (Longuet-Higgins 1986), so the conditions alone are not sufficient: the wrong one
has points behind a photograph. The cost of a candidate is

    sum min(r^2 / 9, 1) + 2 (number of points that fit and lie behind a photograph)

(first term: MSAC, Torr and Zisserman 2000). Points whose rays are parallel within five standard deviations have an
undefined side. The best candidates of each kind are refined with all points and Cauchy weights, and compared again.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.orientation.coplanarity import CAUCHY, REJECTED, TINY, Pair, Rays, parallaxes, refined
from jaxbundle.orientation.five_points import essential_matrices
from jaxbundle.orientation.two_images import distances, homography, motions_from_essential, motions_from_homography

SAMPLE = 5
CANDIDATES = 16, 4  # number of essential matrices and homographies whose points are checked
REFINED = 6, 3  # number of motions of each kind that are refined
REFINING_STEPS = 12
BEHIND = 2.0  # cost of a point behind a photograph
PARALLEL = 5.0  # standard deviations of a direction
DISTINCT = 0.02  # differences of rotation matrices and bases: below this two orientations are equal
TOGETHER = 64  # samples


class Found(NamedTuple):
    """Two different orientations, the better one first, and their costs; infinite if there is no second one."""

    pairs: Pair
    costs: Float[Array, "2"]


def unit_rays(rays: Rays) -> tuple[Float[Array, "point 3"], Float[Array, "point 3"]]:
    """Unit vectors along directions."""
    first, second = (x / jnp.linalg.norm(x, axis=1, keepdims=True) for x in (rays.first, rays.second))
    return first, second


def sides(at: Pair, rays: Rays) -> tuple[Bool[Array, " point"], Bool[Array, " point"]]:
    """Whether points are in front of both photographs; whether they are behind one, for points with a defined side."""
    l1, l2, sine_squared = distances(at.rotation.T, -at.base @ at.rotation, *unit_rays(rays))
    sided = sine_squared > PARALLEL**2 * angular_variance(rays)
    return (l1 > 0) & (l2 > 0), sided & ((l1 <= 0) | (l2 <= 0))


def cost(at: Pair, rays: Rays) -> Float[Array, ""]:
    """The cost: MSAC and points behind; infinite for a candidate with NaN."""
    r = parallaxes(at, rays)
    fits = rays.valid & (jnp.abs(r) < REJECTED)
    behind = sides(at, rays)[1] & fits
    total = _msac(r * r, rays.valid) + BEHIND * jnp.sum(behind).astype(float)
    finite = jnp.isfinite(at.rotation).all() & jnp.isfinite(at.base).all()
    return jnp.where(finite & jnp.isfinite(total), total, jnp.inf)


def search(rays: Rays, key: Array, samples: int) -> Found:
    """The best orientation and the best different one."""
    uniform = jax.random.uniform(key, (samples, rays.first.shape[0]))
    _, chosen = lax.top_k(jnp.where(rays.valid, uniform, -1.0), SAMPLE)
    first, second = unit_rays(rays)

    def one(index: Int[Array, "5"]) -> tuple[Array, Array, Array, Array]:
        e, real = essential_matrices(first[index], second[index])
        h = homography(first[index[:4]], second[index[:4]])
        costs = jnp.where(real, jax.vmap(lambda e: _essential_cost(e, rays))(e), jnp.inf)
        return e, costs, h, _homography_cost(h, rays)

    e, e_cost, h, h_cost = lax.map(one, chosen, batch_size=min(TOGETHER, samples))
    e = _best(e.reshape(-1, 3, 3), e_cost.ravel(), CANDIDATES[0])
    h = _best(h, h_cost, CANDIDATES[1])
    candidates = [jax.vmap(motions_from_essential)(e), jax.vmap(motions_from_homography)(h)[:2]]
    starts = []
    for (r, t), number in zip(candidates, REFINED, strict=True):
        r, t = r.reshape(-1, 3, 3), t.reshape(-1, 3)
        t = t / jnp.maximum(jnp.linalg.norm(t, axis=1, keepdims=True), TINY)
        pairs = Pair(r.swapaxes(1, 2), -jnp.einsum("kij,ki->kj", r, t))
        costs = jax.vmap(lambda at: cost(at, rays))(pairs)
        starts.append(jax.tree.map(lambda x, c=costs, n=number: _best(x, c, n), pairs))
    pairs = jax.tree.map(lambda *x: jnp.concatenate(x), *starts)
    pairs = jax.vmap(lambda at: refined(_finite(at), rays, CAUCHY, REFINING_STEPS)[0])(pairs)
    costs = jax.vmap(lambda at: cost(at, rays))(pairs)
    best = jnp.argmin(costs)
    apart = jnp.sum(jnp.abs(pairs.rotation - pairs.rotation[None, best]), (1, 2))
    apart += jnp.sum(jnp.abs(pairs.base - pairs.base[None, best]), 1)
    others = jnp.where(apart > DISTINCT, costs, jnp.inf)
    both = jnp.stack([best, jnp.argmin(others)])
    return Found(jax.tree.map(lambda x: x[both], pairs), jnp.stack([costs[best], jnp.min(others)]))


def _finite(at: Pair) -> Pair:
    good = jnp.isfinite(at.rotation).all() & jnp.isfinite(at.base).all() & (jnp.max(jnp.abs(at.base)) > 0.1)
    return Pair(jnp.where(good, at.rotation, jnp.eye(3)), jnp.where(good, at.base, jnp.eye(3)[0]))


def _best(values: Array, costs: Array, number: int) -> Array:
    number = min(number, costs.shape[0])
    return values[lax.top_k(-jnp.where(jnp.isnan(costs), jnp.inf, costs), number)[1]]


def _msac(squares: Array, valid: Array) -> Array:
    return jnp.sum(jnp.where(valid, jnp.minimum(squares / REJECTED**2, 1.0), 0.0))


def angular_variance(rays: Rays) -> Float[Array, " point"]:
    """Variance of the angle between both rays of a point, the mean over its directions."""
    parts = ((rays.first, rays.first_covariance), (rays.second, rays.second_covariance))
    return sum((0.5 * jnp.trace(c, axis1=1, axis2=2) / jnp.sum(x * x, 1) for x, c in parts), jnp.zeros(()))


def _essential_cost(e: Float[Array, "3 3"], rays: Rays) -> Float[Array, ""]:
    g1, g2 = rays.second @ e, rays.first @ e.T
    one = jnp.einsum("pi,pij,pj->p", g1[:, :2], rays.first_covariance, g1[:, :2])
    variance = one + jnp.einsum("pi,pij,pj->p", g2[:, :2], rays.second_covariance, g2[:, :2])
    return _msac(jnp.sum(g1 * rays.first, 1) ** 2 / jnp.maximum(variance, TINY), rays.valid)


def _homography_cost(h: Float[Array, "3 3"], rays: Rays) -> Float[Array, ""]:
    first, second = unit_rays(rays)
    moved = first @ h.T
    sine_squared = jnp.sum(jnp.cross(moved, second) ** 2, 1) / jnp.maximum(jnp.sum(moved * moved, 1), TINY)
    return _msac(0.5 * sine_squared / jnp.maximum(angular_variance(rays), TINY), rays.valid)
