"""Adjustment of one image with cofactors and residuals, or of many under vmap, with derivatives.

Under vmap the images are the last, long axis of all arrays. Derivatives are those of the minimum: with the
gradient g(x, data) = 0 and its derivative H, dx = -H^-1 (dg / d data) d data.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int

from jaxbundle.block.unknowns import angles_near
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel, ImagePoint
from jaxbundle.geometry.rotation import Angles, RotationSystem, Scalar
from jaxbundle.numerics.stored import stored
from jaxbundle.orientation.one_image import (
    Equations,
    Measured,
    Orientation,
    corrected,
    equations,
    factorised,
    residuals,
    solved,
)
from jaxbundle.orientation.six_unknowns import UNKNOWNS, backward, cholesky, forward, place
from jaxbundle.orientation.three_points import direct_orientation

IMAGES_AT_ONCE = 512  # measured: 1024 need the same time, more exceed the processor's cache
LINE = 8  # numbers per cache line
UNITS = np.eye(UNKNOWNS)
Symmetric = tuple[tuple[Scalar, ...], ...]


class AdjustedImage(NamedTuple):
    """The orientation, cofactors of its centre and angles, residuals of the points, status of the iterations."""

    at: Orientation
    angles: Angles
    cofactors: Symmetric
    residuals: ImagePoint
    status: Int[Array, "*image"]
    steps: Int[Array, "*image"]


class Start(NamedTuple):
    """The given approximate orientation of an image."""

    centre: Vector
    angles: Angles


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def adjusted_image(
    model: CameraModel, system: RotationSystem, most: int, m: Measured, start: Start | None
) -> AdjustedImage:
    """Adjusts an image from a given start, or from the direct solution."""

    @custom_vmap
    def one(m: Measured, start: Start | None) -> AdjustedImage:
        given = None if start is None else Orientation(system.rotation_from_angles(*start.angles), start.centre)
        solution = solved(model, m, given or direct_orientation(model, m), most)
        return AdjustedImage(
            solution.at,
            *_answer(model, system, solution.at, solution.equations, m, start),
            solution.status,
            solution.steps,
        )

    @one.def_vmap
    def _many(size: int, batched: Any, m: Measured, start: Start | None) -> tuple[AdjustedImage, Any]:
        def images_last(x: Array, is_batched: bool) -> Array:
            return jnp.moveaxis(x, 0, -1) if is_batched else jnp.broadcast_to(x[..., None], (*x.shape, size))

        adjusted = _in_parts(one.fun, size, jax.tree.map(images_last, (m, start), tuple(batched)))
        return adjusted, jax.tree.map(lambda _: True, adjusted)

    return one(m, start)


def _in_parts(of_images: Callable[..., AdjustedImage], size: int, data: tuple[Measured, Start | None]) -> AdjustedImage:
    """Adjusts images in groups that fit into the processor's cache; images are last in `data`, first in the result."""
    parts = -(-size // IMAGES_AT_ONCE)
    length = LINE * (
        -(-size // (parts * LINE)) | 1
    )  # rows at distances of a power of two would evict each other from the cache

    def parted(x: Array) -> Array:
        padded = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, parts * length - size)], mode="edge")
        return jnp.moveaxis(padded.reshape(*x.shape[:-1], parts, length), -2, 0)

    done = lax.map(lambda part: of_images(*part), jax.tree.map(parted, data))
    return jax.tree.map(lambda x: x.reshape(parts * length)[:size] if x.ndim == 2 else _points_behind(x, size), done)


def _points_behind(x: Float[Array, "part point own"], size: int) -> Float[Array, "image point"]:
    return x.transpose(0, 2, 1).reshape(-1, x.shape[1])[:size]


def _answer(
    model: CameraModel, system: RotationSystem, at: Orientation, e: Equations, m: Measured, start: Start | None
) -> tuple[Angles, Symmetric, ImagePoint]:
    """Computes angles, cofactors of centre and angles, and residuals."""
    zero = jnp.zeros_like(at.centre[0])

    def angles(*d: Scalar) -> Angles:
        matrix = corrected(at, [zero, zero, zero, *d]).rotation
        if start is None:
            return system.angles_from_rotation(matrix)
        return angles_near(matrix, jnp.stack(jnp.broadcast_arrays(*start.angles)), system)

    by_angles = [jax.jvp(angles, (zero,) * 3, tuple(zero + u for u in unit))[1] for unit in np.eye(3)]
    by_angles = stored(by_angles, m.zero)
    derivatives = [[*at.rotation[3 * i : 3 * i + 3], zero, zero, zero] for i in range(3)]
    derivatives += [[zero, zero, zero, *(column[i] for column in by_angles)] for i in range(3)]
    factor, scale = stored(factorised(e, 0.0), m.zero)
    rows = stored([forward(factor, [x * k for x, k in zip(row, scale, strict=True)]) for row in derivatives], m.zero)
    lower = [sum(a * b for a, b in zip(rows[i], rows[j], strict=True)) for i in range(UNKNOWNS) for j in range(i + 1)]
    cofactors = tuple(tuple(lower[place(max(i, j), min(i, j))] for j in range(UNKNOWNS)) for i in range(UNKNOWNS))
    vx, vy = (jnp.where(m.weights[0] > 0, v, 0.0) for v in residuals(model, at, m))
    return angles(zero, zero, zero), cofactors, (vx, vy)


@adjusted_image.defjvp
def _derivative(model: CameraModel, system: RotationSystem, most: int, primals: Any, tangents: Any) -> Any:
    """Derivatives by the implicit function theorem; the start has no influence."""
    out = adjusted_image(model, system, most, *primals)
    (m, start), (dm, _) = primals, tangents
    at, zeros = out.at, (jnp.zeros_like(out.at.centre[0]),) * UNKNOWNS

    def gradient(d: tuple[Scalar, ...], m: Measured) -> list[Scalar]:
        return equations(model, corrected(at, list(d)), m).gradient

    units = [tuple(zeros[0] + u for u in unit) for unit in UNITS]
    by_correction = [jax.jvp(lambda *d: gradient(d, m), zeros, unit)[1] for unit in units]
    factor = cholesky([by_correction[j][i] for i in range(UNKNOWNS) for j in range(i + 1)])
    by_data = jax.jvp(lambda m: gradient(zeros, m), (m,), (dm,))[1]
    d = [-x for x in backward(factor, forward(factor, by_data))]
    moved = jax.jvp(lambda *d: corrected(at, list(d)), zeros, tuple(d))[1]

    def answer(at: Orientation, m: Measured) -> tuple[Angles, Symmetric, ImagePoint]:
        return _answer(model, system, at, equations(model, at, m), m, start)

    none: Any = np.zeros(np.shape(out.status), jax.dtypes.float0)
    by_angles, by_cofactors, by_residuals = jax.jvp(answer, (at, m), (moved, dm))[1]
    return out, AdjustedImage(moved, by_angles, by_cofactors, by_residuals, none, none)
