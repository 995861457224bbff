"""Roots of polynomials, in closed form; a scalar may be an array of any shape."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.geometry.rotation import Scalar
from jaxbundle.numerics.stored import stored

TINY = 1e-300  # in place of a divisor that is 0: the result is not finite or is not a root


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
    """Of m^3 + c2 m^2 + c1 m + c0, with c0 <= 0 real and not negative: in closed form (Cardano, Viete)."""
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
