"""The image equation: object point, projection centre and image point lie on one straight line.

    p = R^T (X - X0)          photo vector; R object_from_image, rows a, b, c
    x = -c p_x / p_z          the camera looks along -z: p_z < 0 in front of it
    y = -c p_y / p_z          x to the right, y up

In the notation of Text 000, with f for c and (p_x, p_y, p_z) = (N1, N2, Z*):

    x - x0 = -f [a1 (X - X0) + b1 (Y - Y0) + c1 (Z - Z0)] / [a3 (X - X0) + b3 (Y - Y0) + c3 (Z - Z0)]
    y - y0 = -f [a2 (X - X0) + b2 (Y - Y0) + c2 (Z - Z0)] / [a3 (X - X0) + b3 (Y - Y0) + c3 (Z - Z0)]     (161)

The package contains this equation once, for one ray, with scalar arguments and results; a scalar may be an array of any
shape. All derivatives are automatic derivatives of this function and of the camera model that follows it.
"""

from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.geometry.vectors import Vector


def photo_vector(rotation: Rotation, projection_centre: Vector, object_point: Vector) -> Vector:
    """The photo vector p = R^T (X - X0): the object point in the system of the photograph."""
    a1, a2, a3, b1, b2, b3, c1, c2, c3 = rotation
    dx = object_point[0] - projection_centre[0]
    dy = object_point[1] - projection_centre[1]
    dz = object_point[2] - projection_centre[2]
    return a1 * dx + b1 * dy + c1 * dz, a2 * dx + b2 * dy + c2 * dz, a3 * dx + b3 * dy + c3 * dz


def central_projection(photo_vector: Vector, principal_distance: Scalar) -> tuple[Scalar, Scalar]:
    """The projection (x, y) = -c (p_x, p_y) / p_z, in the unit of the principal distance."""
    scale = -principal_distance / photo_vector[2]
    return scale * photo_vector[0], scale * photo_vector[1]


def collinearity(
    rotation: Rotation, projection_centre: Vector, object_point: Vector, principal_distance: Scalar
) -> tuple[Scalar, Scalar]:
    """Equation (161): the image point (x - x0, y - y0) of an object point (Kraus 2007, eq. 5.3-4).

    Example:
        >>> level = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        >>> x, y = jb.collinearity(level, (0.0, 0.0, 100.0), (20.0, -10.0, 0.0), 50.0)
        >>> x, y
        (10.0, -5.0)
    """
    return central_projection(photo_vector(rotation, projection_centre, object_point), principal_distance)
