"""Essential matrices of two images from five pairs of rays (Nister 2004; Stewenius, Engels, Nister 2006).

With d1, d2 the directions of a point in the systems of both images, X2 = R X1 + t, and E = [t]x R:

    d2^T E d1 = 0              five equations: E = x N1 + y N2 + z N3 + N4
    2 E E^T E - tr(E E^T) E = 0,  det E = 0            ten cubic equations in x, y, z

Elimination gives a 3 x 3 matrix of polynomials in z with the null vector (x, y, 1); its determinant is of the tenth
degree. Each of its real roots gives one matrix. Gauss-Newton steps on the ten equations restore the digits lost in
the elimination.
"""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.geometry import polynomial

ROOTS = 10
REAL = 1e-4  # ratio of imaginary part and 1 + |z|; an almost real pair is refined to the nearest real matrix
POLISHING = 3
# order of the columns: exponents of x^i y^j z^k
MONOMIALS = (
    (3, 0, 0), (0, 3, 0), (2, 1, 0), (1, 2, 0), (2, 0, 1), (2, 0, 0), (0, 2, 1), (0, 2, 0), (1, 1, 1), (1, 1, 0),
    (1, 0, 2), (1, 0, 1), (1, 0, 0), (0, 1, 2), (0, 1, 1), (0, 1, 0), (0, 0, 3), (0, 0, 2), (0, 0, 1), (0, 0, 0),
)  # fmt: skip


def _collected() -> Float[np.ndarray, "64 20"]:
    """Adds the products of three of (x, y, z, 1) that are equal monomials."""
    matrix = np.zeros((64, 20))
    for row, factors in enumerate(product(range(4), repeat=3)):
        powers = (factors.count(0), factors.count(1), factors.count(2))
        matrix[row, MONOMIALS.index(powers)] = 1.0
    return matrix


COLLECTED = _collected()
LEVI_CIVITA = np.array([[[(i - j) * (j - k) * (k - i) / 2 for k in range(3)] for j in range(3)] for i in range(3)])


def essential_matrices(
    first: Float[Array, "5 3"], second: Float[Array, "5 3"]
) -> tuple[Float[Array, "10 3 3"], Bool[Array, " 10"]]:
    """Ten matrices with Frobenius norm sqrt 2, and a mask of the existing ones; `first`, `second`: unit vectors."""
    rows = (second[:, :, None] * first[:, None, :]).reshape(5, 9)
    q, _ = jnp.linalg.qr(rows.T, mode="complete")
    basis = q[:, 5:].T.reshape(4, 3, 3)
    equations = _cubic_equations(basis)
    b = jnp.linalg.solve(equations[:, :10], equations[:, 10:])
    matrix = [_row(b[4], b[5]), _row(b[6], b[7]), _row(b[8], b[9])]
    z = polynomial.all_roots(_determinant(matrix))
    real = jnp.abs(z.imag) < REAL * (1 + jnp.abs(z))
    xyz = jax.vmap(lambda z: _null_vector(matrix, z))(z.real)
    e, misfit = jax.vmap(lambda xyz: _polished(xyz, basis))(xyz)
    return e, real & (misfit < 1e-9) & jnp.isfinite(e).all((1, 2))


def _cubic_equations(n: Float[Array, "4 3 3"]) -> Float[Array, "10 20"]:
    """Coefficients of the ten equations, in the order of `MONOMIALS`."""
    g = jnp.einsum("pik,qlk->pqil", n, n)
    trace = 2 * jnp.einsum("pqil,rlj->pqrij", g, n) - jnp.einsum("pqkk,rij->pqrij", g, n)
    determinant = jnp.einsum("ijk,pi,qj,rk->pqr", LEVI_CIVITA, n[:, 0], n[:, 1], n[:, 2])
    return jnp.concatenate([trace.reshape(64, 9), determinant.reshape(64, 1)], 1).T @ COLLECTED


def _row(with_z: Float[Array, " 10"], without: Float[Array, " 10"]) -> tuple[Array, Array, Array]:
    """One equation minus z times another: coefficients of x, y and 1, polynomials in z, lowest power first."""

    def of(part: slice) -> Array:
        return jnp.pad(with_z[part][::-1], (0, 1)) - jnp.pad(without[part][::-1], (1, 0))

    return of(slice(0, 3)), of(slice(3, 6)), of(slice(6, 10))


def _determinant(m: list[tuple[Array, Array, Array]]) -> Float[Array, " 11"]:
    def minor(i: int, j: int) -> Array:
        return polynomial.product(m[i][0], m[j][1]) - polynomial.product(m[j][0], m[i][1])

    return (
        polynomial.product(minor(1, 2), m[0][2])
        - polynomial.product(minor(0, 2), m[1][2])
        + polynomial.product(minor(0, 1), m[2][2])
    )


def _null_vector(m: list[tuple[Array, Array, Array]], z: Float[Array, ""]) -> Float[Array, "3"]:
    """The unknowns x, y, z from the largest of the vector products of two rows."""
    rows = jnp.stack([jnp.stack([jnp.polyval(c[::-1], z) for c in row]) for row in m])
    rows = rows / jnp.linalg.norm(rows, axis=1, keepdims=True)
    products = jnp.cross(rows, jnp.roll(rows, 1, 0))
    v = products[jnp.argmax(jnp.abs(products[:, 2]))]
    return jnp.stack([v[0] / v[2], v[1] / v[2], z])


def _polished(xyz: Float[Array, "3"], basis: Float[Array, "4 3 3"]) -> tuple[Float[Array, "3 3"], Float[Array, ""]]:
    """The matrix after Gauss-Newton steps, and the maximum misfit of the ten equations."""
    # homogeneous, with unit length: large x, y, z correspond to a small coefficient of N4
    k = jnp.append(xyz, 1.0)
    k = k / jnp.linalg.norm(k)

    def misfits(k: Array) -> Array:
        e = jnp.tensordot(k, basis, 1)
        square = e @ e.T
        cubic = 2 * square @ e - jnp.trace(square) * e
        return jnp.concatenate([cubic.ravel(), jnp.linalg.det(e)[None], (k @ k - 1)[None]])

    for _ in range(POLISHING):
        a, v = jax.jacfwd(misfits)(k), misfits(k)
        k = k - jnp.linalg.solve(a.T @ a + 1e-18 * jnp.eye(4), a.T @ v)
    return jnp.sqrt(2.0) * jnp.tensordot(k, basis, 1), jnp.max(jnp.abs(misfits(k)))
