"""Rotations in space, as nine scalars; angles in radians.

    R = (a1, a2, a3,  b1, b2, b3,  c1, c2, c3)      rows a, b, c: object_from_image

Elementary rotations are right-handed about x and z; about y the two systems differ in sign:

    alpha-omega-kappa   R = A_y(alpha) A_x(omega) A_z(kappa),  A_y = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    omega-phi-kappa     R = R_x(omega) R_y(phi) R_z(kappa)

The first is the matrix (164) of Text 000 with five corrected signs. A scalar may be an array of any shape: all
functions work element by element. Angles of a matrix are computed by splitting off one rotation and taking the other
two from the exact remainder, so the three angles reproduce the matrix also at the singular attitude (omega, phi = +-90
deg), where only the sum or difference of the two outer angles is determined.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Inexact

# also complex: the matrices of angles are analytic, as complex steps require
Scalar = Inexact[Array | np.ndarray, "..."] | float
Rotation = tuple[Scalar, ...]
Angles = tuple[Scalar, Scalar, Scalar]

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def product(left: Rotation, right: Rotation) -> Rotation:
    """The matrix product left right."""
    return tuple(sum(left[3 * i + k] * right[3 * k + j] for k in range(3)) for i in range(3) for j in range(3))


def transpose(rotation: Rotation) -> Rotation:
    """The inverse rotation, which is the transpose."""
    return tuple(rotation[3 * j + i] for i in range(3) for j in range(3))


def apply(rotation: Rotation, vector: Angles) -> Angles:
    """The matrix times a vector."""
    x, y, z = (sum(rotation[3 * i + k] * vector[k] for k in range(3)) for i in range(3))
    return x, y, z


def about_x(angle: Scalar) -> Rotation:
    """Right-handed elementary rotation about the first axis."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    return one, zero, zero, zero, c, -s, zero, s, c


def about_y(angle: Scalar) -> Rotation:
    """Right-handed elementary rotation about the second axis."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    return c, zero, s, zero, one, zero, -s, zero, c


def about_z(angle: Scalar) -> Rotation:
    """Right-handed elementary rotation about the third axis."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(c), jnp.zeros_like(c)
    return c, -s, zero, s, c, zero, zero, zero, one


def from_alpha_omega_kappa(alpha: Scalar, omega: Scalar, kappa: Scalar) -> Rotation:
    """The corrected matrix of Text 000: A_y(alpha) A_x(omega) A_z(kappa)."""
    ca, sa = jnp.cos(alpha), jnp.sin(alpha)
    cw, sw = jnp.cos(omega), jnp.sin(omega)
    ck, sk = jnp.cos(kappa), jnp.sin(kappa)
    return (
        ca * ck - sa * sw * sk,
        -ca * sk - sa * sw * ck,
        -sa * cw,
        cw * sk,
        cw * ck,
        -sw,
        sa * ck + ca * sw * sk,
        -sa * sk + ca * sw * ck,
        ca * cw,
    )


def to_alpha_omega_kappa(rotation: Rotation) -> Angles:
    """Angles of `from_alpha_omega_kappa`; omega in [-90, 90] deg."""
    alpha = jnp.arctan2(-rotation[2], rotation[8])
    remainder = product(about_y(alpha), rotation)  # A_y(-alpha) is the right-handed rotation by +alpha
    kappa = jnp.arctan2(-remainder[1], remainder[0])
    omega = jnp.arctan2(-remainder[5], remainder[8])
    return alpha, omega, kappa


def from_omega_phi_kappa(omega: Scalar, phi: Scalar, kappa: Scalar) -> Rotation:
    """The rotation matrix R_x(omega) R_y(phi) R_z(kappa)."""
    return product(product(about_x(omega), about_y(phi)), about_z(kappa))


def to_omega_phi_kappa(rotation: Rotation) -> Angles:
    """Angles of `from_omega_phi_kappa`; phi in [-90, 90] deg."""
    omega = jnp.arctan2(-rotation[5], rotation[8])
    remainder = product(about_x(-omega), rotation)
    kappa = jnp.arctan2(remainder[3], remainder[4])
    phi = jnp.arctan2(remainder[2], remainder[8])
    return omega, phi, kappa


def from_rotation_vector(x: Scalar, y: Scalar, z: Scalar) -> Rotation:
    """Rotation about the direction (x, y, z) by its length (Rodrigues)."""
    squared = x * x + y * y + z * z
    small = squared < 1e-8  # below this the next term of both series is less than 1e-17
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    a = jnp.where(small, 1 - squared / 6, jnp.sin(angle) / angle)
    b = jnp.where(small, 0.5 - squared / 24, 2 * jnp.sin(angle / 2) ** 2 / safe)
    return (
        1 - b * (y * y + z * z),
        b * x * y - a * z,
        b * x * z + a * y,
        b * x * y + a * z,
        1 - b * (x * x + z * z),
        b * y * z - a * x,
        b * x * z - a * y,
        b * y * z + a * x,
        1 - b * (x * x + y * y),
    )


def to_rotation_vector(rotation: Rotation) -> Angles:
    """The rotation vector of `from_rotation_vector`; its length is at most pi."""
    q0, qx, qy, qz = to_quaternion(rotation)
    squared = qx * qx + qy * qy + qz * qz
    small = squared < 1e-16
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    factor = jnp.where(small, 2.0, 2 * jnp.arctan2(sine, q0) / sine)  # 2 / q0 has no derivative at half a turn
    return factor * qx, factor * qy, factor * qz


def from_quaternion(q0: Scalar, qx: Scalar, qy: Scalar, qz: Scalar) -> Rotation:
    """Rotation of a quaternion, scalar part first; it does not need unit length."""
    s = 2 / (q0 * q0 + qx * qx + qy * qy + qz * qz)
    return (
        1 - s * (qy * qy + qz * qz),
        s * (qx * qy - q0 * qz),
        s * (qx * qz + q0 * qy),
        s * (qx * qy + q0 * qz),
        1 - s * (qx * qx + qz * qz),
        s * (qy * qz - q0 * qx),
        s * (qx * qz - q0 * qy),
        s * (qy * qz + q0 * qx),
        1 - s * (qx * qx + qy * qy),
    )


def to_quaternion(rotation: Rotation) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Unit quaternion with scalar part >= 0, from the largest of its four elements (Shepperd 1978)."""
    a1, a2, a3, b1, b2, b3, c1, c2, c3 = rotation
    squares = (1 + a1 + b2 + c3, 1 + a1 - b2 - c3, 1 - a1 + b2 - c3, 1 - a1 - b2 + c3)
    rows = (
        (squares[0], c2 - b3, a3 - c1, b1 - a2),
        (c2 - b3, squares[1], a2 + b1, a3 + c1),
        (a3 - c1, a2 + b1, squares[2], b3 + c2),
        (b1 - a2, a3 + c1, b3 + c2, squares[3]),
    )
    # with one index from a reduction that is computed once: repeated comparisons may be rounded differently, which
    # would # mix rows of opposite sign for equal squares; and a maximum would mix their derivatives
    largest = jnp.argmax(jnp.stack(jnp.broadcast_arrays(*squares)), 0)

    def chosen(k0: Scalar, k1: Scalar, k2: Scalar, k3: Scalar) -> Scalar:
        return jnp.where(largest == 0, k0, jnp.where(largest == 1, k1, jnp.where(largest == 2, k2, k3)))

    quaternion = [chosen(*column) for column in zip(*rows, strict=True)]
    sign = jnp.where(quaternion[0] < 0, -1.0, 1.0)
    scale = sign / (2 * jnp.sqrt(chosen(*squares)))
    q0, qx, qy, qz = (scale * q for q in quaternion)
    return q0, qx, qy, qz


class RotationSystem(NamedTuple):
    """Three named angles, and the functions from angles to matrix and back."""

    name: str
    angles: tuple[str, str, str]
    rotation_from_angles: Callable[..., Rotation]
    angles_from_rotation: Callable[[Rotation], Angles]


ALPHA_OMEGA_KAPPA = RotationSystem(
    "alpha-omega-kappa", ("alpha", "omega", "kappa"), from_alpha_omega_kappa, to_alpha_omega_kappa
)
OMEGA_PHI_KAPPA = RotationSystem("omega-phi-kappa", ("omega", "phi", "kappa"), from_omega_phi_kappa, to_omega_phi_kappa)
ROTATION_SYSTEMS = {system.name: system for system in (OMEGA_PHI_KAPPA, ALPHA_OMEGA_KAPPA)}
