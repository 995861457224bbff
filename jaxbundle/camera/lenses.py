"""Camera models of wide-angle and of strongly distorting lenses; the residual is formed in the image, v down.

    (u, v) = (xn, -yn) = (p_x, -p_y) / -p_z,  r^2 = u^2 + v^2,  depth = -p_z
    residual = (f x' + b1 x' + b2 y', f y') - (u_measured - x0, v_measured - y0), converted to y up at the end

    opencv-rational  (x', y') = (u, v) (1 + K1 r^2 + K2 r^4 + K3 r^6) / (1 + K4 r^2 + K5 r^4 + K6 r^6) + decentring
    fisheye          (x, y) = (u, v) atan(r) / r,  q^2 = x^2 + y^2
                     (x', y') = (x, y) (1 + K1 q^2 + K2 q^4 + K3 q^6 + K4 q^8) + decentring + (S1, S2) q^2
    fisheye-624      (x, y) as in fisheye, times 1 + K1 q^2 + ... + K6 q^12; then, with w^2 of these,
                     + decentring + (S1 w^2 + S2 w^4, S3 w^2 + S4 w^4)
    fov              (x', y') = (u, v) atan(2 r tan(omega / 2)) / (r omega)          Devernay and Faugeras (2001)
    division         (x', y') = (u, v) 2 / (1 + sqrt(1 - 4 k r^2))                   Fitzgibbon (2001)
    eucm             (x', y') = (u, v) / (alpha sqrt(beta r^2 + 1) + 1 - alpha)      Khomutenko et al. (2016)

Decentring is (P1 (r^2 + 2 x^2) + 2 P2 x y, P2 (r^2 + 2 y^2) + 2 P1 x y), as in `brown`; P1 and P2 are p2 and p1 of
OpenCV and COLMAP. atan(r) is the angle between the axis and a point in front of the camera, below 90 deg. Sources of
opencv-rational and of fisheye without decentring and thin prism: OpenCV's documentation of calib3d; of the others: the
camera models of COLMAP.
"""

from jaxbundle.camera.brown import ORIENTATION
from jaxbundle.camera.collinearity import Vector, central_projection
from jaxbundle.camera.model import CameraModel, ImagePoint, reduced
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.numerics.host import array_module

SMALL = 1e-4  # limit of r^2: below it, the next term of the series of atan(r) / r, r^8 / 9, is below 1e-16


def _normalised(photo_vector: Vector) -> ImagePoint:
    """(u, v), v down."""
    x, y = central_projection(photo_vector, 1.0)
    return x, -y


def _compared(point: ImagePoint, affine: tuple[Scalar, ...], y_axis: Scalar, measured: ImagePoint) -> ImagePoint:
    """The residual of (x', y') with (f, x0, y0, b1, b2)."""
    f, x0, y0, b1, b2 = affine
    x, y = reduced(measured, x0, y0, 1.0, y_axis)
    return (f + b1) * point[0] + b2 * point[1] - x, -f * point[1] - y


def _angle_over_tangent(r2: Scalar) -> Scalar:
    """The function atan(r) / r, with derivatives also at r = 0."""
    xp = array_module(r2)
    small = xp.real(r2) < SMALL
    r = xp.sqrt(xp.where(small, 1.0, r2))
    return xp.where(small, 1 - r2 * (1 / 3 - r2 * (1 / 5 - r2 / 7)), xp.arctan(r) / r)


def _decentring(x: Scalar, y: Scalar, p1: Scalar, p2: Scalar) -> ImagePoint:
    r2 = x * x + y * y
    return p1 * (r2 + 2 * x * x) + 2 * p2 * x * y, p2 * (r2 + 2 * y * y) + 2 * p1 * x * y


def _polynomial(r2: Scalar, *coefficients: Scalar) -> Scalar:
    """1 + k1 r^2 + k2 r^4 + ..."""
    value: Scalar = 0.0
    for k in reversed(coefficients):
        value = r2 * (k + value)
    return 1 + value


def _rational(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, k1, k2, k3, k4, k5, k6, p1, p2, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    r2 = u * u + v * v
    radial = _polynomial(r2, k1, k2, k3) / _polynomial(r2, k4, k5, k6)
    dx, dy = _decentring(u, v, p1, p2)
    return _compared((u * radial + dx, v * radial + dy), (f, x0, y0, b1, b2), y_axis, measured)


def _fisheye(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, k1, k2, k3, k4, p1, p2, s1, s2, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    scale = _angle_over_tangent(u * u + v * v)
    x, y = u * scale, v * scale
    q2 = x * x + y * y
    radial = _polynomial(q2, k1, k2, k3, k4)
    dx, dy = _decentring(x, y, p1, p2)
    point = x * radial + dx + s1 * q2, y * radial + dy + s2 * q2
    return _compared(point, (f, x0, y0, b1, b2), y_axis, measured)


def _fisheye_624(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, k1, k2, k3, k4, k5, k6, p1, p2, s1, s2, s3, s4, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    scale = _angle_over_tangent(u * u + v * v)
    q2 = (u * u + v * v) * scale * scale
    radial = _polynomial(q2, k1, k2, k3, k4, k5, k6) * scale
    x, y = u * radial, v * radial
    w2 = x * x + y * y
    dx, dy = _decentring(x, y, p1, p2)
    point = x + dx + w2 * (s1 + w2 * s2), y + dy + w2 * (s3 + w2 * s4)
    return _compared(point, (f, x0, y0, b1, b2), y_axis, measured)


def _fov(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, omega, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    xp = array_module((omega, u))
    without = xp.real(omega * omega) < 1e-8  # the series below is then exact to rounding
    angle = xp.where(without, 1.0, omega)
    stretch = 2 * xp.tan(angle / 2)
    scale = _angle_over_tangent((u * u + v * v) * stretch * stretch) * stretch / angle
    series = 1 + omega * omega * (1 / 12 - (u * u + v * v) / 3)
    scale = xp.where(without, series, scale)
    return _compared((u * scale, v * scale), (f, x0, y0, b1, b2), y_axis, measured)


def _division(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, k, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    xp = array_module((k, u))
    scale = 2 / (1 + xp.sqrt(1 - 4 * k * (u * u + v * v)))
    return _compared((u * scale, v * scale), (f, x0, y0, b1, b2), y_axis, measured)


def _eucm(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, alpha, beta, b1, b2, y_axis = interior
    u, v = _normalised(photo_vector)
    xp = array_module((beta, u))
    scale = 1 / (alpha * xp.sqrt(beta * (u * u + v * v) + 1) + 1 - alpha)
    return _compared((u * scale, v * scale), (f, x0, y0, b1, b2), y_axis, measured)


_AFFINE = ("b1", "b2", "y_axis")
_SIX = ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2")
RATIONAL = CameraModel("opencv-rational", (*ORIENTATION, *_SIX, *_AFFINE), _rational)
FISHEYE = CameraModel("fisheye", (*ORIENTATION, "K1", "K2", "K3", "K4", "P1", "P2", "S1", "S2", *_AFFINE), _fisheye)
FISHEYE_624 = CameraModel("fisheye-624", (*ORIENTATION, *_SIX, "S1", "S2", "S3", "S4", *_AFFINE), _fisheye_624)
FOV = CameraModel("fov", (*ORIENTATION, "omega", *_AFFINE), _fov)
DIVISION = CameraModel("division", (*ORIENTATION, "k", *_AFFINE), _division)
EUCM = CameraModel("eucm", (*ORIENTATION, "alpha", "beta", *_AFFINE), _eucm)
