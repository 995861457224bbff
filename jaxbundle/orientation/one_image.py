"""Least squares with the six elements of one image as unknowns.

Points are transformed to the current system of the photograph, p = R^T (X - X0). In this system the correction is that
of an image at the origin without rotation, and the rows are automatic derivatives of the image equation:

    v(c, d) = model.residual(interior, photo_vector(I + [d]x, c, p), measured),       X0 <- X0 + R c,  R <- R S(d)

with the rotation S(d) = I + [d]x + ...

The method is Gauss-Newton; if a step does not reduce v^T P v, Marquardt's damping shortens it. The iterations of an

image end with an undamped step. All values are scalars that may be arrays of any shape, with the points first and the
images, if any, last: thousands of images are adjusted by operations on long arrays. Finished images do not change
    during further iterations of others.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.camera.model import CameraModel, Residual
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.numerics.stored import stored
from jaxbundle.orientation.six_unknowns import UNKNOWNS, backward, cholesky, forward, place
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.undetermined import WEAKEST_SHARE

LIMIT = 1e-8  # |J d| / |v| of the last step, as in AngleRule
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-4, 1e-6, 1e16  # below the minimum, no damping
ROUNDING = 4 * float(np.finfo(float).eps)
RUNNING = -1
MAX_TOGETHER = 6  # number of steps after which most images have converged
FEW = 8  # maximum share of images in the further steps


class Measured(NamedTuple):
    """Data of the adjustment of an image; `weights` are 1 / sigma, 0 for unused points."""

    interior: Float[Array, "element *image"]
    points: Float[Array, "3 point *image"]
    coordinates: Float[Array, "2 point *image"]
    weights: Float[Array, "2 point *image"]

    @property
    def zero(self) -> Int[Array, ""]:
        """A 0 that is known only at run time; see `stored`."""
        return jnp.minimum(jnp.sum(self.weights[0] > 0), 0)


class Orientation(NamedTuple):
    """An orientation: rotation object_from_image and projection centre."""

    rotation: Rotation
    centre: Vector


class Equations(NamedTuple):
    """Normal equations: N (lower triangle), J^T P v and v^T P v / 2."""

    normals: list[Scalar]
    gradient: list[Scalar]
    cost: Scalar


class State(NamedTuple):
    """State: the accepted orientation, its equations, and the next orientation to try."""

    at: Orientation
    equations: Equations
    trial: Orientation
    damping: Float[Array, "*image"]
    status: Int[Array, "*image"]
    trials: Int[Array, "*image"]


class Solution(NamedTuple):
    """The adjusted orientation and its equations, status and number of the iterations."""

    at: Orientation
    equations: Equations
    status: Int[Array, "*image"]
    steps: Int[Array, "*image"]


def corrected(at: Orientation, d: list[Scalar]) -> Orientation:
    """The orientation after a correction in the system of the photograph."""
    x, y, z = rotation.apply(at.rotation, (d[0], d[1], d[2]))
    turned = rotation.product(at.rotation, rotation.from_quaternion(1.0, d[3] / 2, d[4] / 2, d[5] / 2))
    return Orientation(turned, (at.centre[0] + x, at.centre[1] + y, at.centre[2] + z))


def residuals(model: CameraModel, at: Orientation, m: Measured) -> Residual:
    """Residuals of all points, unit of the rays."""
    x, y, z = m.points
    p = photo_vector(*_on_images(at), (x, y, z))
    return model.residual(_on_points(m.interior, p[0]), p, (m.coordinates[0], m.coordinates[1]))


def equations(model: CameraModel, at: Orientation, m: Measured) -> Equations:
    """The normal equations of an orientation."""
    x, y, z = m.points
    p = stored(photo_vector(*_on_images(at), (x, y, z)), m.zero)
    interior, measured = _on_points(m.interior, p[0]), (m.coordinates[0], m.coordinates[1])

    def residual(x: Scalar, y: Scalar, z: Scalar, a: Scalar, b: Scalar, c: Scalar) -> Residual:
        turned = (1.0, -c, b, c, 1.0, -a, -b, a, 1.0)
        return model.residual(interior, photo_vector(turned, (x, y, z), p), measured)

    zero = jnp.zeros_like(p[0])
    v, transposed = jax.vjp(residual, *[zero] * UNKNOWNS)
    wx, wy = jnp.broadcast_to(m.weights, (2, *zero.shape))
    ax, ay = transposed((wx, zero)), transposed((zero, wy))
    vx, vy = v[0] * wx, v[1] * wy
    ax, ay, vx, vy = stored((ax, ay, vx, vy), m.zero)
    return Equations(
        [jnp.sum(ax[i] * ax[j] + ay[i] * ay[j], 0) for i in range(UNKNOWNS) for j in range(i + 1)],
        [jnp.sum(a * vx + b * vy, 0) for a, b in zip(ax, ay, strict=True)],
        0.5 * jnp.sum(vx * vx + vy * vy, 0),
    )


def _on_images(at: Orientation) -> Orientation:
    """The orientation with a leading axis of length 1 for the points."""
    return jax.tree.map(lambda x: jnp.expand_dims(x, 0), at)


def _on_points(interior: Array, like: Scalar) -> tuple[Array, ...]:
    return tuple(jnp.broadcast_to(element, jnp.shape(like)) for element in interior)


def factorised(e: Equations, damping: Scalar) -> tuple[list[Scalar], list[Scalar]]:
    """Cholesky factor of N + lambda D, D = diag(N), scaled to the unit diagonal of N; and the scale."""
    scale: list[Scalar] = [1 / jnp.sqrt(e.normals[place(i, i)]) for i in range(UNKNOWNS)]
    scaled: list[Scalar] = [
        1.0 + damping if i == j else e.normals[place(i, j)] * scale[i] * scale[j]
        for i in range(UNKNOWNS)
        for j in range(i + 1)
    ]
    return cholesky(scaled), scale


def _next_step(model: CameraModel, m: Measured, noise: Array, s: State) -> State:
    """Tries an orientation and computes the next one."""
    new = stored(equations(model, s.trial, m), m.zero)
    floor = 4 * ROUNDING * s.equations.cost + 2 * jnp.sqrt(s.equations.cost * noise) + noise
    accepted = (s.trials == 0) | (new.cost <= s.equations.cost + floor)
    running = s.status == RUNNING
    at, e = jax.tree.map(partial(jnp.where, accepted & running), (s.trial, new), (s.at, s.equations))
    less = jnp.where(s.damping > MIN_DAMPING, 0.1 * s.damping, 0.0)
    damping = jnp.where(accepted, less, jnp.maximum(10 * s.damping, FIRST_DAMPING))
    factor, scale = stored(factorised(e, damping), m.zero)
    y = stored(forward(factor, [-g * k for g, k in zip(e.gradient, scale, strict=True)]), m.zero)
    d = stored([x * k for x, k in zip(backward(factor, y), scale, strict=True)], m.zero)
    undamped = damping == 0
    weakest = 1 / jnp.max(jnp.stack([factor[place(i, i)] for i in range(UNKNOWNS)]), 0) ** 2
    met = undamped & (sum(x * x for x in y) <= 2 * (LIMIT**2 * e.cost + noise))  # |J d|^2
    status = jnp.where(met, int(Status.CONVERGED), RUNNING)
    status = jnp.where(damping > MAX_DAMPING, int(Status.STALLED), status)
    status = jnp.where(undamped & ~(weakest > WEAKEST_SHARE), int(Status.SINGULAR), status)
    return State(
        at,
        e,
        jax.tree.map(partial(jnp.where, running), corrected(at, d), s.trial),
        jnp.where(running, damping, s.damping),
        jnp.where(running, status, s.status),
        s.trials + running.astype(s.trials.dtype),
    )


def solved(model: CameraModel, m: Measured, start: Orientation, most: int) -> Solution:
    """Makes at most `most` steps from a start; the few slow images are continued separately."""
    noise = 0.5 * ROUNDING**2 * jnp.sum((m.coordinates * m.weights) ** 2, (0, 1))
    zero, none = jnp.zeros(noise.shape), jnp.zeros(noise.shape, int)
    start = jax.tree.map(lambda x: jnp.broadcast_to(x, noise.shape), start)
    nothing = Equations([zero] * place(UNKNOWNS, 0), [zero] * UNKNOWNS, zero)
    first = State(start, nothing, start, zero, none + RUNNING, none)

    def steps(m: Measured, noise: Array, state: State, most: int) -> State:
        def going(s: State) -> Array:
            return jnp.any((s.status == RUNNING) & (s.trials < most))

        return lax.while_loop(going, partial(_next_step, model, m, noise), state)

    last = steps(m, noise, first, min(MAX_TOGETHER, most))
    if noise.ndim and noise.shape[0] > FEW:
        few = jnp.argsort(last.status != RUNNING)[: noise.shape[0] // FEW]
        m_few, noise_few, last_few = jax.tree.map(lambda x: x[..., few], (m, noise, last))
        last = jax.tree.map(lambda x, y: x.at[..., few].set(y), last, steps(m_few, noise_few, last_few, most))
    last = steps(m, noise, last, most)
    status = jnp.where(last.status == RUNNING, int(Status.MAXIMUM_ITERATIONS), last.status)
    at, (x, y, z) = last.trial, m.points  # the last step, which is too short for a trial, is also applied
    depth = photo_vector(*_on_images(at), (x, y, z))[2]
    behind = jnp.any((depth >= 0) & (m.weights[0] > 0), 0)
    status = jnp.where((status == Status.CONVERGED) & behind, int(Status.DIVERGED), status)
    return Solution(at, last.equations, status, last.trials)
