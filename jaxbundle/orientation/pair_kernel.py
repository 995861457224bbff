"""The relative orientations of many pairs of images at once: samples, candidates, selection and refinement.

    X2 = R X1 + t,   y = R d1,   F = t . (y x d2),   g = |t x y|^2 + |t x d2|^2 - 2 F^2,   r^2 = F^2 / (g sigma^2)

with unit vectors d1, d2 of the rays of a point and the standard deviation sigma of their directions: r is the
y-parallax in units of its standard deviation (Foerstner, Wrobel 2016, ch. 13.3). As for a single pair (`pair_search`),
candidates come from samples of five rays and from homographies of four of them, and the cost of a candidate is

    sum min(r^2 / 9, 1) + 2 (number of points that fit and lie behind a photograph)

All arrays have the pairs last. Costs are summed over the rays, for all candidates of all pairs together.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.geometry.rotation import Rotation, Scalar, apply, from_rotation_vector, product
from jaxbundle.geometry.vectors import Vector, cross, dot, squared, times
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.stored import stored
from jaxbundle.orientation.minimal_samples import TINY, essential_matrices, homography
from jaxbundle.orientation.pair_motions import angles_between, motions_from_essential, motions_from_homography

REJECTED = 9.0  # r^2, three standard deviations
BEHIND = 2.0  # cost of a point behind a photograph
PARALLEL = 25.0  # squared standard deviations of a direction; for closer rays the side is undefined
CANDIDATES = 10, 3  # number of essential matrices and homographies that are decomposed into motions
REFINED = 3, 2  # number of motions of each kind that are refined
STEPS = 10  # Gauss-Newton steps
DISTINCT = 1e-3  # tolerance of `angles_between` and of bases: about 1.3 degrees
TOGETHER = 4  # rays of one iteration of the loop: candidates are read once for all of them


class PairRays(NamedTuple):
    """Unit vectors of common rays, the variance of a direction in rad^2, and a mask of used ones."""

    first: Float[Array, "3 ray pair"]
    second: Float[Array, "3 ray pair"]
    variance: Float[Array, "ray pair"]
    valid: Bool[Array, "ray pair"]


class Motions(NamedTuple):
    """Rotations camera_from_camera and bases t of length 1."""

    rotation: Rotation
    base: Vector


class Ray(NamedTuple):
    """One ray of each pair."""

    first: Vector
    second: Vector
    variance: Scalar
    valid: Bool[Array, "1 pair"]


def _ray(rays: PairRays, k: Int[Array, ""] | int) -> Ray:
    first, second = (tuple(d[:, None, k]) for d in (rays.first, rays.second))
    variance, valid = rays.variance[None, k], rays.valid[None, k]
    return Ray((first[0], first[1], first[2]), (second[0], second[1], second[2]), variance, valid)


def _summed(cost: Callable[[Ray], Scalar], rays: PairRays, like: Scalar) -> Array:
    """The sum of a cost over the rays."""

    def turn(k: Array, total: Array) -> Array:
        return total + sum(cost(_ray(rays, TOGETHER * k + i)) for i in range(TOGETHER))

    return lax.fori_loop(0, rays.valid.shape[0] // TOGETHER, turn, jnp.zeros(jnp.shape(like)))


def _parallax(at: Motions, ray: Ray) -> tuple[Scalar, Scalar, Vector]:
    """Computes r^2, g sigma^2 and y."""
    y = apply(at.rotation, ray.first)
    f = dot(at.base, cross(y, ray.second))
    g = squared(cross(at.base, y)) + squared(cross(at.base, ray.second)) - 2 * f * f
    weight = jnp.maximum(g * ray.variance, TINY)
    return f * f / weight, weight, y


def _motion_cost(at: Motions, rays: PairRays) -> Array:
    def cost(ray: Ray) -> Scalar:
        r2, _, y = _parallax(at, ray)
        a, yt, dt = dot(y, ray.second), dot(y, at.base), dot(ray.second, at.base)
        behind = (1 - a * a > 2 * PARALLEL * ray.variance) & ((a * dt - yt <= 0) | (dt - a * yt <= 0))
        total = jnp.minimum(r2 / REJECTED, 1.0) + jnp.where(behind & (r2 < REJECTED), BEHIND, 0.0)
        return jnp.where(ray.valid, total, 0.0)

    total = _summed(cost, rays, at.base[0])
    return jnp.where(jnp.isfinite(total), total, jnp.inf)


def _essential_cost(e: Float[Array, "9 candidate pair"], rays: PairRays) -> Array:
    def cost(ray: Ray) -> Scalar:
        (a, b, c), (x, y, z) = ray.first, ray.second
        l2 = e[0] * a + e[1] * b + e[2] * c, e[3] * a + e[4] * b + e[5] * c, e[6] * a + e[7] * b + e[8] * c
        l1 = e[0] * x + e[3] * y + e[6] * z, e[1] * x + e[4] * y + e[7] * z, e[2] * x + e[5] * y + e[8] * z
        f = dot(ray.second, l2)
        g = squared(l1) + squared(l2) - 2 * f * f
        r2 = f * f / jnp.maximum(g * ray.variance, TINY)
        return jnp.where(ray.valid, jnp.minimum(r2 / REJECTED, 1.0), 0.0)

    return _summed(cost, rays, e[0])


def _homography_cost(h: Float[Array, "9 candidate pair"], rays: PairRays) -> Array:
    def cost(ray: Ray) -> Scalar:
        y = apply(tuple(h), ray.first)
        r2 = squared(cross(y, ray.second)) / jnp.maximum(2 * squared(y) * ray.variance, TINY)
        return jnp.where(ray.valid, jnp.minimum(r2 / REJECTED, 1.0), 0.0)

    total = _summed(cost, rays, h[0])
    return jnp.where(jnp.isfinite(total), total, jnp.inf)


def _best(values: Float[Array, "k candidate pair"], costs: Float[Array, "candidate pair"], number: int) -> Array:
    """The values of the candidates with the minimum cost."""
    at = lax.top_k(-costs.T, min(number, costs.shape[0]))[1].T
    return jnp.take_along_axis(values, at[None], 1)


def _array(at: Motions) -> Float[Array, "12 candidate pair"]:
    return jnp.stack([*at.rotation, *at.base])


def _motions(values: Float[Array, "12 candidate pair"]) -> Motions:
    return Motions(tuple(values[:9]), (values[9], values[10], values[11]))


def _refined(at: Motions, rays: PairRays, zero: Int[Array, ""]) -> Motions:
    """Gauss-Newton on the parallaxes with Cauchy weights; the derivative of g is left out."""

    def step(_: Array, values: Array) -> Array:
        at = _motions(values)
        t = at.base
        flat = jnp.abs(t[0]) < 0.6
        u = cross(t, (jnp.where(flat, 1.0, 0.0), jnp.where(flat, 0.0, 1.0), jnp.zeros_like(t[0])))
        u = times(1 / jnp.sqrt(squared(u)), u)
        v = cross(t, u)

        def turn(k: Array, sums: Array) -> Array:
            ray = _ray(rays, k)
            r2, variance, y = _parallax(at, ray)
            weight = jnp.where(ray.valid, 1 / (1 + r2 / 4), 0.0) / variance
            across = cross(y, ray.second)
            row = (*cross(y, cross(ray.second, t)), dot(across, u), dot(across, v))
            f = dot(t, across)
            products = [weight * row[i] * row[j] for i in range(5) for j in range(i + 1)]
            return sums + jnp.stack(jnp.broadcast_arrays(*products, *[weight * f * x for x in row]))

        sums = lax.fori_loop(0, rays.valid.shape[0], turn, jnp.zeros((20, *jnp.shape(t[0]))))
        d = stored(_solved(list(sums[:15]), list(sums[15:])), zero)
        size = jnp.sqrt(sum(x * x for x in d))
        d = [-x / jnp.maximum(1.0, 2 * size) for x in d]  # no step beyond half a radian
        good = jnp.isfinite(size)
        turned = product(from_rotation_vector(d[0], d[1], d[2]), at.rotation)
        base = tuple(t[k] + d[3] * u[k] + d[4] * v[k] for k in range(3))
        length = jnp.sqrt(squared((base[0], base[1], base[2])))
        return jnp.where(good, jnp.stack([*turned, *(x / length for x in base)]), values)

    return _motions(lax.fori_loop(0, STEPS, step, _array(at)))


def _solved(matrix: list[Scalar], right: list[Scalar]) -> list[Scalar]:
    """Computes N^-1 b of five unknowns by Cholesky factors; N is increased by a tiny share of its diagonal."""
    n = len(right)
    place = lambda i, j: i * (i + 1) // 2 + j  # noqa: E731
    trifle = 1e-12 * sum(matrix[place(i, i)] for i in range(n))
    factor: list[Scalar] = []
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[place(i, j)] - sum(factor[place(i, k)] * factor[place(j, k)] for k in range(j))
            factor.append(1 / jnp.sqrt(rest + trifle) if i == j else rest * factor[place(j, j)])
    y: list[Scalar] = []
    for i in range(n):
        y.append((right[i] - sum(factor[place(i, k)] * y[k] for k in range(i))) * factor[place(i, i)])
    for i in reversed(range(n)):
        y[i] = (y[i] - sum(factor[place(k, i)] * y[k] for k in range(i + 1, n))) * factor[place(i, i)]
    return y


def _candidates(rays: PairRays, chosen: Int[Array, "5 sample pair"], zero: Int[Array, ""]) -> list[Array]:
    """Motions of the best essential matrices and of the best homographies."""
    samples, pairs = chosen.shape[1:]
    index = jnp.broadcast_to(chosen.reshape(1, -1, pairs), (3, 5 * samples, pairs))
    first, second = (
        stored(jnp.take_along_axis(d, index, 1).reshape(3, 5, -1), zero) for d in (rays.first, rays.second)
    )
    e, exists = essential_matrices(first, second, zero)
    e = stored(e.reshape(9, -1, pairs), zero)
    costs = jnp.where(exists.reshape(-1, pairs), _essential_cost(e, rays), jnp.inf)
    e = stored(_best(jnp.where(jnp.isfinite(e), e, 0.0), costs, CANDIDATES[0]), zero)
    corners = [[(d[0, k], d[1, k], d[2, k]) for k in range(4)] for d in (first, second)]
    h = stored(jnp.stack(homography(*corners)).reshape(9, -1, pairs), zero)
    h = stored(_best(h, _homography_cost(h, rays), CANDIDATES[1]), zero)
    found = []
    for rotation, t in (motions_from_essential(tuple(e)), motions_from_homography(tuple(h))):
        t = times(1 / jnp.maximum(jnp.sqrt(squared(t)), TINY), t)
        found.append(stored(jnp.stack([*rotation, *t]).reshape(12, -1, pairs), zero))
    return found


@Compiled
def oriented_pairs(rays: PairRays, chosen: Int[Array, "5 sample pair"]) -> tuple[Array, Array]:
    """The best orientation of each pair and the best different one, and their costs.

    Returns: nine elements of the rotations and three of the bases, (12, 2, pair); costs (2, pair).
    """
    zero = jnp.minimum(jnp.sum(rays.valid), 0)
    starts = [
        _best(jnp.where(jnp.isfinite(motions), motions, 0.0), _motion_cost(_motions(motions), rays), number)
        for motions, number in zip(_candidates(rays, chosen, zero), REFINED, strict=True)
    ]
    values = _array(_refined(_motions(stored(jnp.concatenate(starts, 1), zero)), rays, zero))
    costs = _motion_cost(_motions(values), rays)
    best = jnp.argmin(costs, 0)[None]
    first = jnp.take_along_axis(values, best[None], 1)
    apart = angles_between(tuple(values[:9]), tuple(first[:9]))
    apart = jnp.maximum(apart, sum((values[k] - first[k]) ** 2 for k in range(9, 12)))
    others = jnp.where(apart > DISTINCT, costs, jnp.inf)
    both = jnp.concatenate([best, jnp.argmin(others, 0)[None]])
    chosen_costs = jnp.stack([jnp.min(costs, 0), jnp.min(others, 0)])
    return jnp.take_along_axis(values, both[None], 1), chosen_costs
