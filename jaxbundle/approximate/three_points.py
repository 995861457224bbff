"""The orientation of an image from three points, without approximate values (Grunert 1841).

With distances s1, s2, s3 from the projection centre, sides a = P2 P3, b = P1 P3, c = P1 P2 and the angles alpha, beta,
gamma between the rays, the law of cosines

    s2^2 + s3^2 - 2 s2 s3 cos alpha = a^2
    s1^2 + s3^2 - 2 s1 s3 cos beta  = b^2
    s1^2 + s2^2 - 2 s1 s2 cos gamma = c^2

leaves an equation of fourth degree in v = s3 / s1 (Haralick, Lee, Ottenberg, Noelle 1994, sec. 3.1), thus up to four
solutions. All quantities are scalars, which may be arrays of any one shape.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.approximate.one_image import Measured, Orientation
from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.numerics.stored import stored

Triple = tuple[Vector, Vector, Vector]
TINY = 1e-300  # in place of a divisor that is 0: what follows is not finite or no solution, and not chosen


def direct_orientation(model: CameraModel, m: Measured) -> Orientation:
    """The orientation of an image from the three points that span the largest angles.

    Of the four solutions that which is the best for all points: the least sum of 1 - cos of the angles off the rays.
    """
    interior = tuple(jnp.broadcast_to(element, m.coordinates[0].shape) for element in m.interior)
    used, zero = m.weights[0] > 0, m.zero
    d = stored(direction(model, interior, (m.coordinates[0], m.coordinates[1])), zero)

    def most(measure: Scalar) -> Array:
        return jnp.argmax(jnp.where(used, measure, -1.0), 0)[None]

    def picked(vector: Any, index: Array) -> Vector:
        x, y, z = (jnp.take_along_axis(v, index, 0)[0] for v in vector)
        return x, y, z

    mean = tuple(jnp.sum(jnp.where(used, x, 0.0), 0) / jnp.sum(used, 0) for x in d)
    first = most(_squared(_minus(d, (mean[0], mean[1], mean[2]))))
    second = most(_squared(_minus(d, picked(d, first))))
    third = most(jnp.abs(_dot(d, _cross(picked(d, first), picked(d, second)))))
    points, directions = ((picked(x, first), picked(x, second), picked(x, third)) for x in (m.points, d))
    points, directions = stored((points, directions), zero)
    rotations, centres = stored(three_point_solutions(points, directions, zero), zero)
    x, y, z, along_x, along_y, along_z = (e[:, None] for e in (*m.points, *d))  # against the axis of the solutions
    vector = photo_vector(rotations, centres, (x, y, z))
    cosine = _dot(vector, (along_x, along_y, along_z)) / jnp.sqrt(_squared(vector))
    misfit = jnp.sum(jnp.where(used[:, None], 1 - cosine, 0.0), 0)
    best = jnp.argmin(jnp.where(jnp.isnan(misfit), jnp.inf, misfit), 0)[None]
    return Orientation(*jax.tree.map(lambda x: jnp.take_along_axis(x, best, 0)[0], (rotations, centres)))


def three_point_solutions(points: Triple, directions: Triple, zero: Int[Array, ""]) -> tuple[Rotation, Vector]:
    """Rotations (object_from_image) and projection centres, four in a new leading axis; not finite where there is none.

    Complex roots take part with their real part: with errors of measurement two equal roots become a complex pair.
    `zero`: see `stored`.
    """
    aa, bb, cc = (_squared(_minus(points[i], points[j])) for i, j in ((1, 2), (0, 2), (0, 1)))
    alpha, beta, gamma = (_dot(directions[i], directions[j]) for i, j in ((1, 2), (0, 2), (0, 1)))  # their cosines
    coefficients = stored(_grunert(aa / bb, cc / bb, alpha, beta, gamma), zero)
    v = stored(quartic_roots(coefficients, zero), zero)
    s1_squared = bb / (1 + v * v - 2 * v * beta)
    # s2 from the triangle with side c has two solutions: that which fits side a better
    root = jnp.sqrt(jnp.maximum(cc / s1_squared - 1 + gamma * gamma, 0.0))
    u, other = gamma + root, gamma - root
    misfit, other_misfit = (jnp.abs(x * x + v * v - 2 * x * v * alpha - aa / s1_squared) for x in (u, other))
    u = jnp.where(misfit <= other_misfit, u, other)
    s1 = jnp.sqrt(jnp.where((v > 0) & (u > 0), s1_squared, jnp.nan))
    s1, u = stored((s1, u), zero)
    one, two, three = directions
    in_image = _times(s1, one), _times(u * s1, two), _times(v * s1, three)
    a, b = stored((_axes(points), _axes(in_image)), zero)
    object_from_image = stored(rotation.product(a, rotation.transpose(b)), zero)
    centre = _minus(points[0], rotation.apply(object_from_image, in_image[0]))
    return object_from_image, centre


def _grunert(a: Scalar, c: Scalar, alpha: Scalar, beta: Scalar, gamma: Scalar) -> tuple[Scalar, ...]:
    """Coefficients of v^4 ... v^0; `a`, `c`: a^2 / b^2, c^2 / b^2."""
    p, q = a - c, a + c
    return (
        (p - 1) ** 2 - 4 * c * alpha**2,
        4 * (p * (1 - p) * beta - (1 - q) * alpha * gamma + 2 * c * alpha**2 * beta),
        2
        * (
            p * p
            - 1
            + 2 * p * p * beta**2
            + 2 * (1 - c) * alpha**2
            - 4 * q * alpha * beta * gamma
            + 2 * (1 - a) * gamma**2
        ),
        4 * (-p * (1 + p) * beta + 2 * a * gamma**2 * beta - (1 - q) * alpha * gamma),
        (1 + p) ** 2 - 4 * a * gamma**2,
    )


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


def _axes(points: Triple) -> Rotation:
    """Matrix whose columns are the axes of a triangle: first side, its normal crossed with it, the normal."""
    side = _unit(_minus(points[1], points[0]))
    normal = _unit(_cross(side, _minus(points[2], points[0])))
    across = _cross(normal, side)
    return tuple(axis[i] for i in range(3) for axis in (side, across, normal))


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _times(s: Scalar, a: Vector) -> Vector:
    return s * a[0], s * a[1], s * a[2]


def _dot(a: Vector, b: Vector) -> Scalar:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _squared(a: Vector) -> Scalar:
    return _dot(a, a)


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Vector) -> Vector:
    return _times(1 / jnp.sqrt(_squared(a)), a)
