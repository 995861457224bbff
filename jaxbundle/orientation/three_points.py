"""The orientation of an image from three points, without approximate values (Grunert 1841).

With distances s1, s2, s3 from the projection centre, sides a = P2 P3, b = P1 P3, c = P1 P2 and the angles alpha, beta,
gamma between the rays, the law of cosines

    s2^2 + s3^2 - 2 s2 s3 cos alpha = a^2
    s1^2 + s3^2 - 2 s1 s3 cos beta  = b^2
    s1^2 + s2^2 - 2 s1 s2 cos gamma = c^2

gives an equation of fourth degree in v = s3 / s1 (Haralick, Lee, Ottenberg, Noelle 1994, eq. 9), thus up to four
solutions. Two solutions may have equal v and differ only in u = s2 / s1, so both u of each v are candidates. Newton
steps on the three equations decide which of the eight candidates are solutions.

Half of the derivative of the equations with respect to the distances,

        [ 0               s2 - s3 cos alpha   s3 - s2 cos alpha ]
    J = [ s1 - s3 cos beta   0                s3 - s1 cos beta  ]
        [ s1 - s2 cos gamma  s2 - s1 cos gamma   0              ]

is singular if two solutions coincide: the projection centre lies on the danger cylinder through the circumscribed
circle of the three points. All quantities are scalars, which may be arrays of one shape.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry import rotation
from jaxbundle.geometry.polynomial import quartic_roots
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.geometry.vectors import Vector, cross, dot, minus, squared, times, unit
from jaxbundle.numerics.stored import stored
from jaxbundle.orientation.one_image import Measured, Orientation

Triple = tuple[Vector, Vector, Vector]
# a candidate from the closed form has 8 digits or is not a solution; at a double root a step halves the error
NEWTON_STEPS = 5
SOLVED = 1e-9  # share of the squares of the sides: misfit of the law of cosines
SAME = 1e-7  # share of the distances: solutions that differ by less are equal


class ThreePointSolutions(NamedTuple):
    """Four candidates in a new leading axis, solutions first; NaN for missing ones.

    `distances`: from the projection centre to the points. `determinant`: of J, its rows scaled to unit length, 0 on the
    danger cylinder. `exact`: whether the law of cosines is satisfied. If not, the values belong to the real part of a
    complex root: random errors can make a complex pair of two equal roots.
    """

    rotation: Rotation
    centre: Vector
    distances: Vector
    determinant: Scalar
    exact: Bool[Array, "4 ..."]


def direct_orientation(model: CameraModel, m: Measured) -> Orientation:
    """Computes the orientation of an image from the three points that span the largest angles.

    The solution with the minimum sum of 1 - cos of the angles over all points is selected.
    """
    interior = tuple(jnp.broadcast_to(element, m.coordinates[0].shape) for element in m.interior)
    used, zero = m.weights[0] > 0, m.zero
    d = stored(direction(model, interior, (m.coordinates[0], m.coordinates[1])), zero)

    def most(measure: Scalar) -> Array:
        return jnp.argmax(jnp.where(used, measure, -1.0), 0)[None]

    def picked(vector: Any, index: Array) -> Vector:
        x, y, z = (jnp.take_along_axis(v, index, 0) for v in vector)
        return x, y, z

    count = jnp.sum(used, 0, keepdims=True).astype(float)
    mean = tuple(jnp.sum(jnp.where(used, x, 0.0), 0, keepdims=True) / count for x in d)
    first = most(squared(minus(d, (mean[0], mean[1], mean[2]))))
    second = most(squared(minus(d, picked(d, first))))
    third = most(jnp.abs(dot(d, cross(picked(d, first), picked(d, second)))))
    points, directions = ((picked(x, first), picked(x, second), picked(x, third)) for x in (m.points, d))
    points, directions = stored(jax.tree.map(lambda x: x[0], (points, directions)), zero)
    solutions = three_point_solutions(points, directions, zero)
    rotations, centres = stored((solutions.rotation, solutions.centre), zero)
    x, y, z, along_x, along_y, along_z = (
        e[:, None] for e in (*m.points, *d)
    )  # broadcast over the axis of the solutions
    each_rotation, each_centre = _with_solutions((rotations, centres))
    vector = photo_vector(each_rotation, each_centre, (x, y, z))
    cosine = dot(vector, (along_x, along_y, along_z)) / jnp.sqrt(squared(vector))
    misfit = jnp.sum(jnp.where(used[:, None], 1 - cosine, 0.0), 0)
    best = jnp.argmin(jnp.where(jnp.isnan(misfit), jnp.inf, misfit), 0)[None]
    return Orientation(*jax.tree.map(lambda x: jnp.take_along_axis(x, best, 0)[0], (rotations, centres)))


def three_point_solutions(points: Triple, directions: Triple, zero: Int[Array, ""]) -> ThreePointSolutions:
    """All rotations (object_from_image) and projection centres; `directions`: unit vectors. `zero`: see `stored`."""
    sides = squared(minus(points[1], points[2])), squared(minus(points[0], points[2])), squared(minus(*points[:2]))
    cosines = dot(*directions[1:]), dot(directions[0], directions[2]), dot(*directions[:2])
    sides, cosines = stored((sides, cosines), zero)
    candidates, is_fallback = _candidates(sides, cosines, zero)
    s = candidates = stored(candidates, zero)
    points, directions, sides, cosines = _with_solutions((points, directions, sides, cosines))
    for _ in range(NEWTON_STEPS):
        s = stored(minus(s, _newton_step(s, sides, cosines)), zero)
    largest = jnp.maximum(jnp.maximum(sides[0], sides[1]), sides[2])
    misfit = jnp.max(jnp.abs(jnp.stack(_law_of_cosines(s, sides, cosines))), 0) / largest
    shortest = jnp.minimum(jnp.minimum(s[0], s[1]), s[2])
    exact = _without_repeats(s, (misfit < SOLVED) & (shortest > 0))
    kept = jnp.argsort(jnp.where(exact, 0, jnp.where(is_fallback, 1, 2)), axis=0)[:4]
    exact, is_fallback, s, candidates = jax.tree.map(
        lambda x: jnp.take_along_axis(x, kept, 0), (exact, is_fallback, s, candidates)
    )
    s = jax.tree.map(lambda x, y: jnp.where(exact, x, jnp.where(is_fallback, y, jnp.nan)), s, candidates)
    s = stored(s, zero)
    one, two, three = directions
    in_image = times(s[0], one), times(s[1], two), times(s[2], three)
    a, b = stored((_axes(points), _axes(in_image)), zero)
    object_from_image = stored(rotation.product(a, rotation.transpose(b)), zero)
    centre = minus(points[0], rotation.apply(object_from_image, in_image[0]))
    rows = [unit(row) for row in _derivative(s, cosines)]
    return ThreePointSolutions(object_from_image, centre, s, dot(rows[0], cross(rows[1], rows[2])), exact)


def _candidates(sides: Vector, cosines: Vector, zero: Int[Array, ""]) -> tuple[Vector, Bool[Array, "8 ..."]]:
    """Distances from both u of each v, and whether it is the one whose real part is used without a solution."""
    (aa, bb, cc), (alpha, beta, gamma) = sides, cosines
    v = stored(quartic_roots(stored(_grunert(aa / bb, cc / bb, alpha, beta, gamma), zero), zero), zero)
    aa, bb, cc, alpha, beta, gamma = _with_solutions((aa, bb, cc, alpha, beta, gamma))
    s1_squared = bb / (1 + v * v - 2 * v * beta)
    root = jnp.sqrt(jnp.maximum(cc / s1_squared - 1 + gamma * gamma, 0.0))
    u, v = jnp.stack([gamma + root, gamma - root]), v[None]
    misfit = jnp.abs(u * u + v * v - 2 * u * v * alpha[None] - (aa / s1_squared)[None])
    better = jnp.stack([misfit[0] <= misfit[1], misfit[0] > misfit[1]])
    s1 = jnp.sqrt(s1_squared)[None]
    is_fallback = better & (v > 0) & (u > 0)
    shape = (8, *jnp.shape(v)[2:])
    s1, s2, s3 = (jnp.broadcast_to(x, u.shape).reshape(shape) for x in (s1, u * s1, v * s1))
    return (s1, s2, s3), is_fallback.reshape(shape)


def _with_solutions(tree: Any) -> Any:
    """Arrays with a leading axis of length 1 for the solutions."""
    return jax.tree.map(lambda x: x[None], tree)


def _law_of_cosines(s: Vector, sides: Vector, cosines: Vector) -> Vector:
    """Misfits of the three equations."""
    (s1, s2, s3), (alpha, beta, gamma) = s, cosines
    return (
        s2 * s2 + s3 * s3 - 2 * s2 * s3 * alpha - sides[0],
        s1 * s1 + s3 * s3 - 2 * s1 * s3 * beta - sides[1],
        s1 * s1 + s2 * s2 - 2 * s1 * s2 * gamma - sides[2],
    )


def _derivative(s: Vector, cosines: Vector) -> Triple:
    """The rows of J."""
    (s1, s2, s3), (alpha, beta, gamma) = s, cosines
    zero = jnp.zeros_like(s1)
    return (
        (zero, s2 - s3 * alpha, s3 - s2 * alpha),
        (s1 - s3 * beta, zero, s3 - s1 * beta),
        (s1 - s2 * gamma, s2 - s1 * gamma, zero),
    )


def _newton_step(s: Vector, sides: Vector, cosines: Vector) -> Vector:
    """Corrections to subtract from the distances: (2 J)^-1 times the misfits."""
    one, two, three = _derivative(s, cosines)
    columns = cross(two, three), cross(three, one), cross(one, two)  # elements of the inverse times the determinant
    determinant = dot(one, columns[0])
    misfits = _law_of_cosines(s, sides, cosines)
    scale = 0.5 / jnp.where(determinant == 0, jnp.inf, determinant)
    x, y, z = (scale * sum(f * column[i] for f, column in zip(misfits, columns, strict=True)) for i in range(3))
    return x, y, z


def _without_repeats(s: Vector, valid: Bool[Array, "8 ..."]) -> Bool[Array, "8 ..."]:
    """Removes repeated solutions."""
    kept, distances = [valid[0]], jnp.stack(s)
    for i in range(1, 8):
        difference = jnp.sum(jnp.abs(distances[:, i, None] - distances[:, :i]), 0)
        apart = difference > SAME * jnp.sum(jnp.abs(distances[:, i, None]), 0)
        kept.append(valid[i] & jnp.all(apart | ~jnp.stack(kept), 0))
    return jnp.stack(kept)


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


def _axes(points: Triple) -> Rotation:
    """Matrix whose columns are the axes of a triangle: first side, its normal crossed with it, the normal."""
    side = unit(minus(points[1], points[0]))
    normal = unit(cross(side, minus(points[2], points[0])))
    across = cross(normal, side)
    return tuple(axis[i] for i in range(3) for axis in (side, across, normal))
