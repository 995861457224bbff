"""Eigenvalues and eigenvectors of symmetric 3 x 3 matrices by Jacobi's rotations (1846).

All values are scalars, which may be arrays of any shape.
"""

import jax.numpy as jnp
from jax import lax

from jaxbundle.geometry.rotation import Scalar
from jaxbundle.geometry.vectors import Vector

SWEEPS = 5  # sweeps: convergence is quadratic, after four only rounding remains
TINY = 1e-300

Symmetric = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


def eigenvectors(m: Symmetric) -> tuple[Vector, tuple[Vector, Vector, Vector]]:
    """Eigenvalues in decreasing order, and unit eigenvectors; `m`: xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = jnp.broadcast_arrays(*m)
    one, zero = jnp.ones_like(xx), jnp.zeros_like(xx)
    start = (xx, yy, zz, yz, xz, xy, ((one, zero, zero), (zero, one, zero), (zero, zero, one)))
    # diagonal d0 d1 d2; o0, o1, o2 are opposite: o0 couples 1 and 2
    d0, d1, d2, *_, columns = lax.fori_loop(0, SWEEPS, lambda _, s: _sweep(s), start)
    values, vectors = [d0, d1, d2], list(columns)
    for i, j in ((0, 1), (1, 2), (0, 1)):
        swap = values[j] > values[i]
        values[i], values[j] = jnp.where(swap, values[j], values[i]), jnp.where(swap, values[i], values[j])
        a, b = vectors[i], vectors[j]
        vectors[i] = tuple(jnp.where(swap, y, x) for x, y in zip(a, b, strict=True))
        vectors[j] = tuple(jnp.where(swap, x, y) for x, y in zip(a, b, strict=True))
    return (values[0], values[1], values[2]), (vectors[0], vectors[1], vectors[2])


def _sweep(state: tuple) -> tuple:
    """One sweep: a rotation for each pair of axes."""
    *numbers, columns = state
    d, o, columns = list(numbers[:3]), list(numbers[3:]), list(columns)
    for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        small = jnp.abs(o[r]) < TINY
        theta = (d[q] - d[p]) / (2 * jnp.where(small, 1.0, o[r]))
        t = jnp.where(theta >= 0, 1.0, -1.0) / (jnp.abs(theta) + jnp.sqrt(theta * theta + 1))
        t = jnp.where(small, 0.0, t)
        c = 1 / jnp.sqrt(t * t + 1)
        s = t * c
        d[p], d[q] = d[p] - t * o[r], d[q] + t * o[r]
        o[r] = jnp.zeros_like(o[r])
        # o[q] couples p and r, o[p] couples q and r
        o[q], o[p] = c * o[q] - s * o[p], s * o[q] + c * o[p]
        a, b = columns[p], columns[q]
        columns[p] = tuple(c * x - s * y for x, y in zip(a, b, strict=True))
        columns[q] = tuple(s * x + c * y for x, y in zip(a, b, strict=True))
    return (*d, *o, tuple(columns))
