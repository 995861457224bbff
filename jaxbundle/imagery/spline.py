"""Cubic B-splines through the grey values of a window, with their exact derivatives.

    g(x) = sum_i c_i B(x - i),      (c_{i-1} + 4 c_i + c_{i+1}) / 6 = g_i,      mirrored at the first and last pixel

(Unser, Aldroubi, Eden 1993). A window is small, so its prefilter is a matrix, made once on the host. The interpolant
has continuous second derivatives; automatic differentiation gives them exactly. In matching, its bias between pixels is
less than a tenth of that of bilinear interpolation.

Image coordinates count from the corner of the window; the centre of its first pixel is (0.5, 0.5).
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

MIN_SIZE = 4  # px: minimum size for the spline


@cache
def prefilter(size: int) -> Float[np.ndarray, "size size"]:
    """The matrix from grey values to spline coefficients along one axis."""
    if size < MIN_SIZE:
        raise ValueError(f"a window of {size} px is too small for a cubic spline; give at least {MIN_SIZE}")
    sums = (4 * np.eye(size) + np.eye(size, k=1) + np.eye(size, k=-1)) / 6
    sums[0, 1] = sums[-1, -2] = 2 / 6
    matrix = np.linalg.solve(sums, np.eye(size))
    matrix.setflags(write=False)
    return matrix


def coefficients(window: Float[Array, "row column"]) -> Float[Array, "row column"]:
    """Spline coefficients of the grey values of a window."""
    rows, columns = window.shape
    return jnp.asarray(prefilter(rows)) @ window @ jnp.asarray(prefilter(columns)).T


def _weights(t: Array) -> tuple[Array, Array, Array, Array]:
    """The weights B(t + 1), B(t), B(t - 1), B(t - 2) for t from 0 to 1."""
    s = 1 - t
    return s * s * s / 6, (4 + t * t * (3 * t - 6)) / 6, (4 + s * s * (3 * s - 6)) / 6, t * t * t / 6


def _knots(x: Array, size: int) -> tuple[Array, Array]:
    """The pixel to the left of each position, and the distance from its centre.

    Near the border the polynomial is continued.
    """
    index = lax.stop_gradient(jnp.clip(jnp.floor(x - 0.5), 1, size - 3))
    return index.astype(jnp.int32), x - 0.5 - index


def value(spline: Float[Array, "row column"], x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """Grey values at image coordinates of the window, from its spline coefficients."""
    rows, columns = spline.shape
    (j, tx), (i, ty) = _knots(x, columns), _knots(y, rows)
    wx, wy = _weights(tx), _weights(ty)
    flat, first = spline.ravel(), (i - 1) * columns + j - 1
    lines = [sum((wx[b] * flat[first + (a * columns + b)] for b in range(4)), jnp.zeros(())) for a in range(4)]
    return sum((wy[a] * lines[a] for a in range(4)), jnp.zeros(()))


def bilinear(window: Float[Array, "row column"], x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """Grey values by bilinear interpolation of the pixels, only for comparison: it biases matches."""
    rows, columns = window.shape
    left = lax.stop_gradient(jnp.clip(jnp.floor(x - 0.5), 0, columns - 2))
    top = lax.stop_gradient(jnp.clip(jnp.floor(y - 0.5), 0, rows - 2))
    tx, ty = x - 0.5 - left, y - 0.5 - top
    flat, first = window.ravel(), top.astype(jnp.int32) * columns + left.astype(jnp.int32)
    upper = (1 - tx) * flat[first] + tx * flat[first + 1]
    lower = (1 - tx) * flat[first + columns] + tx * flat[first + columns + 1]
    return (1 - ty) * upper + ty * lower
