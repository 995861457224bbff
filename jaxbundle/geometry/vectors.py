"""Vectors in space, as three scalars; a scalar may be an array of any shape."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxbundle.geometry.rotation import Scalar

Vector = tuple[Scalar, Scalar, Scalar]


def components(rows: Float[np.ndarray, "... 3"]) -> Vector:
    """The components of many vectors: sums over three long arrays are faster than over many rows of three."""
    x, y, z = (np.ascontiguousarray(rows[..., k]) for k in range(3))
    return x, y, z


def plus(a: Vector, b: Vector) -> Vector:
    """The sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vector, b: Vector) -> Vector:
    """The difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def times(s: Scalar, a: Vector) -> Vector:
    """A multiple of a vector."""
    return s * a[0], s * a[1], s * a[2]


def dot(a: Vector, b: Vector) -> Scalar:
    """The scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def squared(a: Vector) -> Scalar:
    """The square of the length."""
    return dot(a, a)


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def unit(a: Vector) -> Vector:
    """The vector of length 1; not finite for a vector of length 0."""
    return times(1 / jnp.sqrt(squared(a)), a)
