"""The 3 x 3 normal matrix of an object point in explicit form: V = L L^T.

All quantities are scalars, which may be arrays of one shape. The inverse of a pivot is stored instead of the pivot; 0
means a fixed coordinate: its correction is 0 and it has no effect.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry.rotation import Scalar

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # stored elements of V
STORED = 12  # stored numbers of a point: factor (6), gradient (3), diagonal of V (3)
Truth = Bool[Array, "..."]
Symmetric = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]  # 00, 01, 02, 11, 12, 22


class PointFactor(NamedTuple):
    """Inverse pivots and the off-diagonal elements of L."""

    i0: Scalar
    i1: Scalar
    i2: Scalar
    l10: Scalar
    l20: Scalar
    l21: Scalar


class PointEquations(NamedTuple):
    """Stored equations of the points: factor of V, gradient and diagonal of V before damping."""

    factor: PointFactor
    gradient: list[Array]
    diagonal: list[Array]


def point_equations(stored: Float[Array, "tile value"], n: int) -> PointEquations:
    """The equations of `n` points per tile from their stored rows."""
    number = [stored[:, k * n : (k + 1) * n] for k in range(STORED)]
    return PointEquations(PointFactor(*number[:6]), number[6:9], number[9:])


def factorise(v: Symmetric, free: tuple[Truth, Truth, Truth]) -> PointFactor:
    """Cholesky factor of V; `free` is true for unknown coordinates. Not finite if V is not positive definite."""

    def inverse_root(pivot: Scalar, free: Truth) -> Scalar:
        return jnp.where(free, lax.rsqrt(jnp.where(free, pivot, 1.0)), 0.0)

    i0 = inverse_root(v[0], free[0])
    l10, l20 = v[1] * i0, v[2] * i0
    i1 = inverse_root(v[3] - l10 * l10, free[1])
    l21 = (v[4] - l20 * l10) * i1
    i2 = inverse_root(v[5] - l20 * l20 - l21 * l21, free[2])
    return PointFactor(i0, i1, i2, l10, l20, l21)


def forward(f: PointFactor, b: Vector) -> Vector:
    """Solves L x = b."""
    y0 = b[0] * f.i0
    y1 = (b[1] - f.l10 * y0) * f.i1
    y2 = (b[2] - f.l20 * y0 - f.l21 * y1) * f.i2
    return y0, y1, y2


def backward(f: PointFactor, y: Vector) -> Vector:
    """Solves L^T x = y."""
    x2 = y[2] * f.i2
    x1 = (y[1] - f.l21 * x2) * f.i1
    x0 = (y[0] - f.l10 * x1 - f.l20 * x2) * f.i0
    return x0, x1, x2
