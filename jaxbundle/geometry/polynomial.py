"""Products and roots of polynomials.

The fourth degree has a closed form, with scalars that may be arrays of any shape; any degree is solved by iteration.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from jaxbundle.geometry.rotation import Scalar
from jaxbundle.numerics.stored import stored

TINY = 1e-300  # instead of a divisor of 0: the result is not finite or is not a root
ABERTH_STEPS = 30  # 25 are sufficient for 300 random polynomials of degree 10
ASYMMETRY = 0.4  # rad; a start symmetric to the real axis would stay symmetric


def quartic_roots(coefficients: tuple[Scalar, ...], zero: Int[Array, ""]) -> Float[Array, "4 ..."]:
    """Real parts of the four roots of a4 x^4 + ... + a0, by Ferrari's method; `zero`: see `stored`."""
    a4, a3, a2, a1, a0 = coefficients
    a4 = jnp.where(jnp.abs(a4) < TINY, TINY, a4)
    b, c, d, e = a3 / a4, a2 / a4, a1 / a4, a0 / a4
    # x = y - b / 4:  y^4 + p y^2 + q y + r
    p = c - 3 * b * b / 8
    q = d - b * c / 2 + b**3 / 8
    r = e - b * d / 4 + b * b * c / 16 - 3 * b**4 / 256
    p, q, r = stored((p, q, r), zero)
    m = stored(_largest_root(p, p * p / 4 - r, -q * q / 8), zero)
    root = jnp.sqrt(2 * jnp.maximum(m, 0.0))
    # 2 q / root, by the resolvent without the division: in a symmetric figure both are 0
    split = jnp.where(q < 0, -4.0, 4.0) * jnp.sqrt(jnp.maximum((m + p / 2) ** 2 - r, 0.0))
    inner = [jnp.sqrt(jnp.maximum(-2 * (p + m) - sign * split, 0.0)) for sign in (1, -1)]
    roots = (root + inner[0], root - inner[0], -root + inner[1], -root - inner[1])
    return jnp.stack([x / 2 - b / 4 for x in roots])


def _largest_root(c2: Scalar, c1: Scalar, c0: Scalar) -> Scalar:
    """A real root of m^3 + c2 m^2 + c1 m + c0 with c0 <= 0 that is not negative, in closed form (Cardano, Viete)."""
    q = (c2 * c2 - 3 * c1) / 9
    r = (2 * c2**3 - 9 * c2 * c1 + 27 * c0) / 54
    three = r * r < q**3
    root = jnp.sqrt(jnp.maximum(q, TINY))
    angle = jnp.arccos(jnp.clip(r / root**3, -1.0, 1.0))
    a = -jnp.sign(r) * jnp.cbrt(jnp.abs(r) + jnp.sqrt(jnp.maximum(r * r - q**3, 0.0)))
    one = a + q / jnp.where(a == 0, 1.0, a)
    m = jnp.where(three, -2 * root * jnp.cos((angle + 2 * jnp.pi) / 3), one) - c2 / 3
    for _ in range(2):  # the closed form loses digits
        slope = (3 * m + 2 * c2) * m + c1
        m = m - (((m + c2) * m + c1) * m + c0) / jnp.where(slope == 0, 1.0, slope)
    return m


def product(a: Float[Array, " m"], b: Float[Array, " n"]) -> Float[Array, " k"]:
    """Coefficients of the product of two polynomials, the lowest power first."""
    m, n = a.shape[0], b.shape[0]
    return sum((jnp.pad(a[i] * b, (i, m - 1 - i)) for i in range(m)), jnp.zeros(m + n - 1))


def all_roots(coefficients: Float[Array, " k"]) -> Complex[Array, " n"]:
    """All n = k - 1 complex roots at once, from coefficients with the lowest power first (Aberth 1973).

    A root that is many times larger than the others may be missed.
    """
    degree = coefficients.shape[0] - 1
    leading = jnp.where(jnp.abs(coefficients[-1]) < TINY, TINY, coefficients[-1])
    c = coefficients / leading
    number = jnp.arange(degree, dtype=c.dtype)
    radius = jnp.max(jnp.abs(c[:-1]) ** (1 / (degree - number)))
    c, angle = c.astype(complex), 2 * jnp.pi * number / degree + ASYMMETRY
    start = radius.astype(complex) * jnp.exp(1j * angle.astype(complex))

    def step(_: Array, z: Array) -> Array:
        value, slope = jnp.full_like(z, c[-1]), jnp.zeros_like(z)
        for k in range(degree - 1, -1, -1):
            slope = slope * z + value
            value = value * z + c[k]
        newton = value / jnp.where(slope == 0, TINY, slope)
        difference = z[:, None] - z[None]
        repelled = jnp.sum(jnp.where(difference == 0, 0.0, 1 / jnp.where(difference == 0, 1.0, difference)), 1)
        change = newton / (1 - newton * repelled)
        return jnp.where(jnp.isfinite(change), z - change, z)

    return lax.fori_loop(0, ABERTH_STEPS, step, start)
