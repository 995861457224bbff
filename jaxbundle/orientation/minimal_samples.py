"""Essential matrices and homographies of many samples at once, as scalars that are long arrays.

The equations are those of `five_points`; here the arrays have the samples last, for vector operations of the processor.
The root finder does not iterate until all roots are found: a lost root does not matter, because other samples have it.
    Real roots of the determinant are searched as sign changes on half of a circle,

    z = tan theta,        cos^10(theta) det(z) = sum c_k sin^k(theta) cos^(10 - k)(theta)

so that large roots are found as well as small ones.
"""

from functools import reduce
from operator import add

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.geometry.rotation import Scalar
from jaxbundle.geometry.vectors import Vector, cross, dot
from jaxbundle.numerics.stored import stored
from jaxbundle.orientation.five_points import COLLECTED

ROOTS = 6  # number of real roots that are used; at most ten exist, on average four to five
GRID = 64  # directions for the check of the sign; two roots in one interval of 2.8 degrees are not found
ROOT_STEPS = 10  # steps of regula falsi
TINY = 1e-300
Matrix = tuple[Scalar, ...]  # nine, row by row

_THETA = np.pi * (np.arange(GRID + 1) / GRID - 0.5) + 0.01
_SINE, _COSINE = np.sin(_THETA), np.cos(_THETA)
_POWERS = np.stack([_SINE**k * _COSINE ** (10 - k) for k in range(11)], 1)


def essential_matrices(
    first: Float[Array, "3 5 sample"], second: Float[Array, "3 5 sample"], zero: Int[Array, ""]
) -> tuple[Float[Array, "9 root sample"], Bool[Array, "root sample"]]:
    """Matrices with Frobenius norm sqrt 2, row by row, and a mask of existing ones. `first`, `second`: unit vectors.

    `zero`: see `stored`."""
    products = jnp.moveaxis(second[:, None] * first[None, :], 2, 0)
    basis = stored(_null_space(products.reshape(5, 9, -1), zero), zero)
    equations = _eliminated(stored(_cubic_equations(basis.reshape(4, 3, 3, -1)), zero), zero)
    rows = [_row(equations[i], equations[i + 1]) for i in (4, 6, 8)]
    sine, cosine, exists = _roots(stored(_determinant(rows), zero), zero)
    z = sine / jnp.where(jnp.abs(cosine) < 1e-12, 1e-12, cosine)
    vectors = [(_value(a, z), _value(b, z), _value(c, z)) for a, b, c in rows]
    products = [cross(vectors[i], vectors[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    x, y, w = products[0]
    for other in products[1:]:
        larger = jnp.abs(other[2]) > jnp.abs(w)
        x, y, w = (jnp.where(larger, b, a) for a, b in zip((x, y, w), other, strict=True))
    x, y, z, one = x, y, z * w, w
    e = _added([jnp.asarray(factor)[None] * basis[k][:, None] for k, factor in enumerate((x, y, z, one))])
    e = e * jnp.sqrt(2 / jnp.maximum(jnp.sum(e * e, 0, keepdims=True), TINY))
    return e, exists & jnp.isfinite(e).all(0)


def _null_space(rows: Float[Array, "5 9 sample"], zero: Int[Array, ""]) -> Float[Array, "4 9 sample"]:
    """Four orthonormal vectors orthogonal to the five rows (last step: Gram-Schmidt)."""
    solved = _eliminated(rows, zero)
    unit = jnp.broadcast_to(-jnp.eye(4)[:, :, None], (4, 4, rows.shape[-1]))
    vectors = stored(jnp.concatenate([jnp.swapaxes(solved, 0, 1), unit], 1), zero)
    done: list[Array] = []
    for k in range(4):
        v = vectors[k]
        for other in done:
            v = v - _inner(v, other)[None] * other
        v = stored(v, zero)
        done.append(stored(v / jnp.sqrt(jnp.maximum(_inner(v, v), TINY))[None], zero))
    return jnp.stack(done)


def _inner(a: Float[Array, "9 sample"], b: Float[Array, "9 sample"]) -> Float[Array, " sample"]:
    return _added([a[i] * b[i] for i in range(9)])  # explicit sum: a reduction over a short axis is not vectorised


def _added(terms: list[Array]) -> Array:
    """The explicit sum of a few arrays."""
    return reduce(add, terms)


def _eliminated(a: Float[Array, "n m sample"], zero: Int[Array, ""]) -> Float[Array, "n k sample"]:
    """A^-1 B of rows [A, B] by Gauss-Jordan elimination, with pivots from all remaining rows."""
    rows = a.shape[0]
    number = jnp.arange(rows)[:, None]

    def step(k: Array, a: Array) -> Array:
        column = stored(a[:, k], zero)
        size = jnp.where(number >= k, jnp.abs(column), -1.0)
        best, at = size[0], jnp.zeros(a.shape[2:], int)
        for i in range(1, rows):
            larger = size[i] > best
            best, at = jnp.where(larger, size[i], best), jnp.where(larger, i, at)
        at = stored(at, zero)
        pivot, divisor = a[0], column[0]
        for i in range(1, rows):
            pivot, divisor = jnp.where(at == i, a[i], pivot), jnp.where(at == i, column[i], divisor)
        pivot = stored(pivot / jnp.where(divisor == 0, TINY, divisor)[None], zero)
        chosen = number == at[None]
        factor = jnp.where(chosen, column[k], column)
        rest = jnp.where(chosen[:, None], a[k], a) - factor[:, None] * pivot[None]
        return jnp.where((number == k)[:, None], pivot, rest)

    return lax.fori_loop(0, rows, step, a)[:, rows:]


def _cubic_equations(n: Float[Array, "4 3 3 sample"]) -> Float[Array, "10 20 sample"]:
    """Coefficients of the ten equations, in the order of `five_points.MONOMIALS`."""
    g = _added([n[:, None, :, None, k] * n[None, :, None, :, k] for k in range(3)])
    trace = g[:, :, 0, 0] + g[:, :, 1, 1] + g[:, :, 2, 2]
    t = 2 * _added([g[:, :, None, :, None, k] * n[None, None, :, None, k] for k in range(3)])
    t = t - trace[:, :, None, None, None] * n[None, None]
    minors = {}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        minors[i, j] = n[:, None, 1, i] * n[None, :, 2, j] - n[:, None, 1, j] * n[None, :, 2, i]
    d = (
        n[:, None, None, 0, 0] * minors[1, 2][None]
        - n[:, None, None, 0, 1] * minors[0, 2][None]
        + n[:, None, None, 0, 2] * minors[0, 1][None]
    )
    products = jnp.concatenate([t.reshape(64, 9, -1), d.reshape(64, 1, -1)], 1)
    return jnp.swapaxes(jnp.tensordot(jnp.asarray(COLLECTED.T), products, 1), 0, 1)


def _row(with_z: Float[Array, "10 sample"], without: Float[Array, "10 sample"]) -> tuple[Array, Array, Array]:
    """One equation minus z times another: coefficients of x, y and 1, polynomials in z, lowest power first."""

    def of(part: slice) -> Array:
        return jnp.pad(with_z[part][::-1], ((0, 1), (0, 0))) - jnp.pad(without[part][::-1], ((1, 0), (0, 0)))

    return of(slice(0, 3)), of(slice(3, 6)), of(slice(6, 10))


def _product(a: Float[Array, "m sample"], b: Float[Array, "n sample"]) -> Float[Array, "k sample"]:
    m = a.shape[0]
    return _added([jnp.pad(a[i, None] * b, ((i, m - 1 - i), (0, 0))) for i in range(m)])


def _determinant(m: list[tuple[Array, Array, Array]]) -> Float[Array, "11 sample"]:
    def minor(i: int, j: int) -> Array:
        return _product(m[i][0], m[j][1]) - _product(m[j][0], m[i][1])

    return _product(minor(1, 2), m[0][2]) - _product(minor(0, 2), m[1][2]) + _product(minor(0, 1), m[2][2])


def _roots(c: Float[Array, "11 sample"], zero: Int[Array, ""]) -> tuple[Array, Array, Array]:
    """Sine and cosine of the first roots, and a mask of existing ones."""
    values = jnp.tensordot(jnp.asarray(_POWERS), c, 1)
    changes = (values[:-1] < 0) != (values[1:] < 0)
    changes = stored(changes.astype(int), zero) > 0
    rank = jnp.cumsum(changes, 0)
    ends = []
    for k in range(ROOTS):
        here = changes & (rank == k + 1)
        at = jnp.argmax(here, 0)
        ends.append((at, here.any(0)))
    at, exists = jnp.stack([x for x, _ in ends]), jnp.stack([x for _, x in ends])
    sine, cosine = jnp.asarray(_SINE), jnp.asarray(_COSINE)
    low, high = (sine[at], cosine[at]), (sine[at + 1], cosine[at + 1])

    def value(u: Array) -> Array:
        s, t = low[0] + u * (high[0] - low[0]), low[1] + u * (high[1] - low[1])
        total, power = jnp.broadcast_to(c[10], s.shape), t
        for k in range(9, -1, -1):
            total = total * s + c[None, k] * power
            power = power * t
        return total

    def step(_: Array, state: tuple) -> tuple:
        a, fa, b, fb = state
        u = a - fa * (b - a) / jnp.where(fb == fa, TINY, fb - fa)
        f = value(u)
        opposite = (f < 0) != (fb < 0)
        # regula falsi with half of the unchanged value (Illinois)
        return jnp.where(opposite, b, a), jnp.where(opposite, fb, 0.5 * fa), u, f

    zero, one = jnp.zeros(at.shape), jnp.ones(at.shape)
    u = lax.fori_loop(0, ROOT_STEPS, step, (zero, value(zero), one, value(one)))[2]
    return low[0] + u * (high[0] - low[0]), low[1] + u * (high[1] - low[1]), exists & jnp.isfinite(u)


def _value(c: Float[Array, "k sample"], z: Float[Array, "root sample"]) -> Float[Array, "root sample"]:
    total = jnp.zeros_like(z)
    for k in range(c.shape[0] - 1, -1, -1):
        total = total * z + c[None, k]
    return total


def homography(first: list[Vector], second: list[Vector]) -> Matrix:
    """The matrix with second ~ H first for four pairs of rays; not finite if three of them are in a plane."""
    a = cross(first[1], first[2]), cross(first[2], first[0]), cross(first[0], first[1])
    b = cross(second[1], second[2]), cross(second[2], second[0]), cross(second[0], second[1])
    factors = [dot(b[k], second[3]) / dot(a[k], first[3]) for k in range(3)]
    return tuple(sum(factors[k] * second[k][i] * a[k][j] for k in range(3)) for i in range(3) for j in range(3))
