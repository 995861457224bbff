"""The 18 partial derivatives of the image equation in closed form, equations (162)-(164) of Text 000.

    V_x = A1 dX0 + A2 dY0 + A3 dZ0 + A4 dalpha + A5 domega + A6 dkappa + A7 dX + A8 dY + A9 dZ + L_x
    V_y = B1 dX0 + B2 dY0 + B3 dZ0 + B4 dalpha + B5 domega + B6 dkappa + B7 dX + B8 dY + B9 dZ + L_y        (162)

With x, y for x - x0, y - y0, with dX = X - X0 and so on, and Z* = a3 dX + b3 dY + c3 dZ, as printed:

    A1 = (a1 f + a3 x) / Z*                                   B1 = (a2 f + a3 y) / Z*
    A2 = (b1 f + b3 x) / Z*                                   B2 = (b2 f + b3 y) / Z*
    A3 = (c1 f + c3 x) / Z*                                   B3 = (c2 f + c3 y) / Z*
    A4 = f (c1 dX - a1 dZ) / Z* + x (c3 dX - a3 dZ) / Z*      B4 = f (c2 dX - a2 dZ) / Z* + y (c3 dX - a3 dZ) / Z*
    A5 = -f sin k + x (tan w + dY / (Z* cos w))               B5 = -f cos k + y (tan w + dY / (Z* cos w))
    A6 = y                                                    B6 = -x
    A7, A8, A9 = -A1, -A2, -A3                                B7, B8, B9 = -B1, -B2, -B3                    (163)

All are correct if a1 ... c3 are those of `from_alpha_omega_kappa`. A1-A3, A7-A9, B1-B3, B7-B9 are correct for any
matrix, A4-A6, B4-B6 only for that one. A5 and B5 are 0/0 at omega = +-90 deg, a horizontal camera looking along the Y
axis; by

    tan w + dY / (Z* cos w) = -(x sin k + y cos k) / f

and the image equation, the partials of the angles are free of it:

    A4 = -f b2 - b3 y + (x / f) (b1 y - b2 x)                 B4 =  f b1 + b3 x + (y / f) (b1 y - b2 x)
    A5 = -f sin k - (x / f) (x sin k + y cos k)               B5 = -f cos k - (y / f) (x sin k + y cos k)

They verify the automatic derivatives of the image equation; adjustments do not use them.
"""

import jax.numpy as jnp

from jaxbundle.camera.collinearity import Vector, central_projection, photo_vector
from jaxbundle.geometry.rotation import Angles, Rotation, Scalar

Partials = tuple[Scalar, ...]

UNKNOWNS = ("X0", "Y0", "Z0", "alpha", "omega", "kappa", "X", "Y", "Z")
NAMES = (*(f"A{k}" for k in range(1, 10)), *(f"B{k}" for k in range(1, 10)))

FORMULAS = (
    "(a1 f + a3 x) / Z*",
    "(b1 f + b3 x) / Z*",
    "(c1 f + c3 x) / Z*",
    "-f b2 - b3 y + (x / f) (b1 y - b2 x)",
    "-f sin k - (x / f) (x sin k + y cos k)",
    "y",
    "-(a1 f + a3 x) / Z*",
    "-(b1 f + b3 x) / Z*",
    "-(c1 f + c3 x) / Z*",
    "(a2 f + a3 y) / Z*",
    "(b2 f + b3 y) / Z*",
    "(c2 f + c3 y) / Z*",
    "f b1 + b3 x + (y / f) (b1 y - b2 x)",
    "-f cos k - (y / f) (x sin k + y cos k)",
    "-x",
    "-(a2 f + a3 y) / Z*",
    "-(b2 f + b3 y) / Z*",
    "-(c2 f + c3 y) / Z*",
)
"""The partial derivatives that are correct everywhere, as text."""

MATRIX_ELEMENTS = (
    ("a1", "cos a cos k - sin a sin w sin k", "cos a cos k - sin a sin w sin k"),
    ("a2", "cos a sin k - sin a cos w cos k", "-cos a sin k - sin a sin w cos k"),
    ("a3", "sin a cos w", "-sin a cos w"),
    ("b1", "cos w sin k", "cos w sin k"),
    ("b2", "cos w cos k", "cos w cos k"),
    ("b3", "sin w", "-sin w"),
    ("c1", "sin a cos k + cos a sin w sin k", "sin a cos k + cos a sin w sin k"),
    ("c2", "sin a sin k + cos a sin w cos k", "-sin a sin k + cos a sin w cos k"),
    ("c3", "cos a cos w", "cos a cos w"),
)
"""The matrix (164): element, as printed, as it is in `from_alpha_omega_kappa`."""


def printed_matrix(alpha: Scalar, omega: Scalar, kappa: Scalar) -> Rotation:
    """The matrix (164) exactly as printed: not a rotation, with five misprints in four elements (a2 has two).

    Example:
        >>> len(jb.textbook.printed_matrix(0.1, 0.2, 0.3))
        9
    """
    ca, sa = jnp.cos(alpha), jnp.sin(alpha)
    cw, sw = jnp.cos(omega), jnp.sin(omega)
    ck, sk = jnp.cos(kappa), jnp.sin(kappa)
    return (
        ca * ck - sa * sw * sk,
        ca * sk - sa * cw * ck,
        sa * cw,
        cw * sk,
        cw * ck,
        sw,
        sa * ck + ca * sw * sk,
        sa * sk + ca * sw * ck,
        ca * cw,
    )


def printed_partials(
    rotation: Rotation, angles: Angles, projection_centre: Vector, object_point: Vector, principal_distance: Scalar
) -> Partials:
    """The partials A1 ...

    A9, B1 ... B9 exactly as in (163); `rotation` is the matrix of `angles` (alpha, omega, kappa).

    Example:
        >>> level = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        >>> len(jb.textbook.printed_partials(level, (0.0, 0.0, 0.0), (0.0, 0.0, 100.0), (20.0, -10.0, 0.0), 50.0))
        18
    """
    a1, a2, a3, b1, b2, b3, c1, c2, c3 = rotation
    _, omega, kappa = angles
    f = principal_distance
    dx, dy, dz = (point - centre for point, centre in zip(object_point, projection_centre, strict=True))
    p = photo_vector(rotation, projection_centre, object_point)
    x, y = central_projection(p, f)
    z = p[2]
    tilt = jnp.tan(omega) + dy / (z * jnp.cos(omega))
    return (
        (a1 * f + a3 * x) / z,
        (b1 * f + b3 * x) / z,
        (c1 * f + c3 * x) / z,
        f / z * (c1 * dx - a1 * dz) + x / z * (c3 * dx - a3 * dz),
        -f * jnp.sin(kappa) + x * tilt,
        y,
        -(a1 * f + a3 * x) / z,
        -(b1 * f + b3 * x) / z,
        -(c1 * f + c3 * x) / z,
        (a2 * f + a3 * y) / z,
        (b2 * f + b3 * y) / z,
        (c2 * f + c3 * y) / z,
        f / z * (c2 * dx - a2 * dz) + y / z * (c3 * dx - a3 * dz),
        -f * jnp.cos(kappa) + y * tilt,
        -x,
        -(a2 * f + a3 * y) / z,
        -(b2 * f + b3 * y) / z,
        -(c2 * f + c3 * y) / z,
    )


def regular_partials(
    rotation: Rotation, angles: Angles, projection_centre: Vector, object_point: Vector, principal_distance: Scalar
) -> Partials:
    """The 18 partials in a form without 0/0, correct in all attitudes, including omega = +-90 deg.

    Example:
        >>> level = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        >>> len(jb.textbook.regular_partials(level, (0.0, 0.0, 0.0), (0.0, 0.0, 100.0), (20.0, -10.0, 0.0), 50.0))
        18
    """
    a1, a2, a3, b1, b2, b3, c1, c2, c3 = rotation
    f = principal_distance
    p = photo_vector(rotation, projection_centre, object_point)
    x, y = central_projection(p, f)
    z = p[2]
    sk, ck = jnp.sin(angles[2]), jnp.cos(angles[2])
    about_alpha = (b1 * y - b2 * x) / f
    about_omega = -(x * sk + y * ck) / f
    x_shift = (a1 * f + a3 * x) / z, (b1 * f + b3 * x) / z, (c1 * f + c3 * x) / z
    y_shift = (a2 * f + a3 * y) / z, (b2 * f + b3 * y) / z, (c2 * f + c3 * y) / z
    x_turn = -f * b2 - b3 * y + x * about_alpha, -f * sk + x * about_omega, y
    y_turn = f * b1 + b3 * x + y * about_alpha, -f * ck + y * about_omega, -x
    return (
        *(*x_shift, *x_turn, *(-a for a in x_shift)),
        *(*y_shift, *y_turn, *(-b for b in y_shift)),
    )
