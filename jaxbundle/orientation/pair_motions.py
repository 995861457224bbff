"""Rotations and bases of many pairs of images, from essential matrices and homographies, as scalars.

The equations are those of `two_images`, for scalars that may be arrays of any shape: X2 = R X1 + t.
"""

import jax.numpy as jnp

from jaxbundle.geometry.rotation import Rotation, Scalar, apply, product, transpose
from jaxbundle.geometry.symmetric import eigenvectors
from jaxbundle.geometry.vectors import Vector, cross, squared, times
from jaxbundle.orientation.minimal_samples import TINY, Matrix


def _rows(m: Matrix) -> tuple[Vector, Vector, Vector]:
    return (m[0], m[1], m[2]), (m[3], m[4], m[5]), (m[6], m[7], m[8])


def _stacked(motions: list[tuple[Rotation, Vector]]) -> tuple[Rotation, Vector]:
    """Stacks several motions in a new leading axis."""
    rotation = tuple(jnp.stack([r[k] for r, _ in motions]) for k in range(9))
    x, y, z = (jnp.stack([t[k] for _, t in motions]) for k in range(3))
    return rotation, (x, y, z)


def motions_from_essential(e: Matrix) -> tuple[Rotation, Vector]:
    """The four motions of a matrix with Frobenius norm sqrt 2, with bases of length 1 (Horn 1990)."""
    a, b, c = _rows(e)
    # the base is orthogonal to the columns of E: the largest of the vector products of two of them
    columns = (e[0], e[3], e[6]), (e[1], e[4], e[7]), (e[2], e[5], e[8])
    products = [cross(columns[i], columns[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
    t, size = products[0], squared(products[0])
    for other in products[1:]:
        larger = squared(other) > size
        t = tuple(jnp.where(larger, x, y) for x, y in zip(other, t, strict=True))
        size = jnp.where(larger, squared(other), size)
    t = times(1 / jnp.sqrt(jnp.maximum(size, TINY)), (t[0], t[1], t[2]))
    cofactors = (*cross(b, c), *cross(c, a), *cross(a, b))
    moved = product((0.0, -t[2], t[1], t[2], 0.0, -t[0], -t[1], t[0], 0.0), e)
    one, two = (tuple(x - s * y for x, y in zip(cofactors, moved, strict=True)) for s in (1.0, -1.0))
    back = times(-1.0, t)
    return _stacked([(one, t), (one, back), (two, t), (two, back)])


def motions_from_homography(h: Matrix) -> tuple[Rotation, Vector]:
    """The four motions of a homography, with bases in units of the distance of the plane (Ma and others 2004)."""
    a, b, c = _rows(h)
    sign = jnp.where(sum(x * y for x, y in zip(a, cross(b, c), strict=True)) < 0, -1.0, 1.0)
    h = tuple(sign * x for x in h)
    square = product(transpose(h), h)
    values, (v1, v2, v3) = eigenvectors((square[0], square[1], square[2], square[4], square[5], square[8]))
    scale = jnp.maximum(values[1], TINY)
    h, s1, s3 = tuple(x / jnp.sqrt(scale) for x in h), values[0] / scale, values[2] / scale
    spread = jnp.sqrt(jnp.maximum(s1 - s3, TINY))
    along, across = jnp.sqrt(jnp.maximum(1 - s3, 0.0)) / spread, jnp.sqrt(jnp.maximum(s1 - 1, 0.0)) / spread
    motions = []
    for sign in (1.0, -1.0):
        u = _sum(times(along, v1), times(sign * across, v3))
        n = cross(v2, u)
        hv, hu = apply(h, v2), apply(h, u)
        hn = cross(hv, hu)
        r = tuple(hv[i] * v2[j] + hu[i] * u[j] + hn[i] * n[j] for i in range(3) for j in range(3))
        t = apply(tuple(x - y for x, y in zip(h, r, strict=True)), n)
        motions += [(r, t), (r, times(-1.0, t))]
    return _stacked(motions)


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def angles_between(first: Rotation, second: Rotation) -> Scalar:
    """Sum of the squares of the differences of two matrices: twice the squared angle of a small rotation."""
    return sum((x - y) ** 2 for x, y in zip(first, second, strict=True))
