"""Least-squares similarities to control, from many starts at once.

    v = lambda R x + T - X,        Q = Q_X + lambda^2 R Q_x R^T,        sum v^T Q^-1 v = min

Coordinates that are not observed are not used: their rows are 0, and Q has unit rows and columns for them. With
Q = L L^T the weighted residuals are L^-1 v, and their derivatives with respect to the seven unknowns

    lambda <- lambda (1 + d_0),   R <- Exp(d_1, d_2, d_3) R,   T <- T + (d_4, d_5, d_6)

are automatic, including that of L: errors of both systems are treated equally. Coordinates are centred, with scale 1.

Levenberg-Marquardt steps start from the 24 rotations that map the coordinate axes onto each other, and from the closed
form with the points with three given coordinates. So all minima are found that one of the starts converges to.
"""

from itertools import permutations, product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxbundle.geometry.rotation import from_rotation_vector
from jaxbundle.geometry.similarity import Similarity

UNKNOWNS = 7
MAX_STEPS = 100
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-12, 1e12
SETTLED = 1e-11  # step relative to the size of the unknowns
ROUNDING = 1e-28  # share of the sum of squares of the weighted coordinates
CUBE = np.array(
    [
        matrix
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(matrix := np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0
    ]
)


class Control(NamedTuple):
    """Points in both systems and their covariances; `observed`: whether an object coordinate is used."""

    model: Float[Array, "point 3"]
    object_points: Float[Array, "point 3"]
    observed: Bool[Array, "point 3"]
    model_covariance: Float[Array, "point 3 3"]
    object_covariance: Float[Array, "point 3 3"]


class Fit(NamedTuple):
    """A minimum: its similarity, weighted sum of squares, normal equations and whether the iterations converged."""

    similarity: Similarity
    cost: Float[Array, ""]
    normals: Float[Array, "7 7"]
    converged: Bool[Array, ""]


def changed(at: Similarity, d: Float[Array, "7"]) -> Similarity:
    """The similarity after small corrections."""
    turn = jnp.stack(from_rotation_vector(d[1], d[2], d[3])).reshape(3, 3)
    return Similarity(at.scale * (1 + d[0]), turn @ at.rotation, at.translation + d[4:])


def residuals(at: Similarity, c: Control) -> Float[Array, "point 3"]:
    """Residuals transformed - given, 0 for coordinates that are not observed."""
    return jnp.where(c.observed, at(c.model) - c.object_points, 0.0)


def weighted_residuals(at: Similarity, c: Control) -> Float[Array, "point 3"]:
    """The weighted residuals L^-1 v."""
    turned = at.scale**2 * at.rotation @ c.model_covariance @ at.rotation.T
    both = c.observed[:, :, None] & c.observed[:, None, :]
    q = jnp.where(both, c.object_covariance + turned, jnp.eye(3))
    factor = jnp.linalg.cholesky(q)
    return jax.scipy.linalg.solve_triangular(factor, residuals(at, c)[..., None], lower=True)[..., 0]


def start(rotation: Float[Array, "3 3"], c: Control) -> Similarity:
    """Scale from the extents of all observed coordinates, translation from their means."""
    turned, number = c.model @ rotation.T, jnp.maximum(jnp.sum(c.observed, 0), 1).astype(float)

    def mean(x: Array) -> Array:
        return jnp.sum(jnp.where(c.observed, x, 0.0), 0) / number

    def extent(x: Array) -> Array:
        return jnp.sum(jnp.where(c.observed, x - mean(x)[None], 0.0)[:, :2] ** 2)

    scale = jnp.sqrt(extent(c.object_points) / jnp.maximum(extent(turned), 1e-6 * extent(c.object_points)))
    return Similarity(scale, rotation, mean(c.object_points - scale * turned))


def fitted(first: Similarity, c: Control) -> Fit:
    """The minimum that is reached from a start."""

    def linearised(at: Similarity) -> tuple[Array, Array, Array]:
        def weighted(d: Array) -> Array:
            return weighted_residuals(changed(at, d), c).ravel()

        v, a = weighted(jnp.zeros(UNKNOWNS)), jax.jacfwd(weighted)(jnp.zeros(UNKNOWNS))
        return v @ v, a.T @ a, a.T @ v

    floor = ROUNDING * jnp.sum(weighted_residuals(Similarity(jnp.zeros(()), jnp.eye(3), jnp.zeros(3)), c) ** 2)

    def step(state: tuple) -> tuple:
        at, (cost, normals, gradient), damping, number, _ = state
        diagonal = jnp.diagonal(normals)
        damped = normals + jnp.diag(damping * diagonal + 1e-14 * jnp.max(diagonal))
        d = -jnp.linalg.solve(damped, gradient)
        d = d / jnp.maximum(1.0, 2 * jnp.abs(d[0]))  # the scale must be positive
        trial = changed(at, d)
        new = linearised(trial)
        accepted = new[0] <= cost * (1 + 1e-12) + floor
        at, equations = jax.tree.map(
            lambda x, y: jnp.where(accepted, x, y), (trial, new), (at, (cost, normals, gradient))
        )
        less = jnp.maximum(0.1 * damping, MIN_DAMPING)
        settled = accepted & (jnp.max(jnp.abs(d)) < SETTLED)
        return at, equations, jnp.where(accepted, less, 10 * damping), number + 1, settled

    def going(state: tuple) -> Array:
        return ~state[4] & (state[3] < MAX_STEPS) & (state[2] < MAX_DAMPING)

    state = (first, linearised(first), jnp.asarray(FIRST_DAMPING), jnp.zeros((), int), jnp.asarray(False))
    at, (cost, normals, _), _, number, settled = lax.while_loop(going, step, state)
    return Fit(at, cost, normals, settled | (number < MAX_STEPS))


def all_fits(closed: Similarity, c: Control) -> Fit:
    """The minima from all 25 starts, in a leading axis."""
    starts = jax.vmap(lambda rotation: start(rotation, c))(jnp.asarray(CUBE))
    usable = jnp.isfinite(closed.scale) & (closed.scale > 0)
    closed = jax.tree.map(lambda x, y: jnp.where(usable, x, y[0]), closed, starts)
    starts = jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), closed, starts)
    return jax.vmap(lambda first: fitted(first, c))(starts)
