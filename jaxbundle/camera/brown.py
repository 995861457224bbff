"""Camera models that correct the measurement by Brown's distortion; the residual is formed in the corrected plane.

    none                 v = ((xs, ys) - (x, y)) / s
    brown                v = ((xs, ys) - D((1 + b1) x + b2 y, y)) / s
    brown-affine-last    v = ((xs, ys) - ((1 + b1) x2 + b2 y2, y2)) / s,  (x2, y2) = D(x, y)
    brown-scale-first    v = ((xs, ys) - D(((1 + b1) u - x0) s, y)) / s

    D(x, y) = (x (1 + K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 x^2) + 2 P2 x y,
               y (1 + K1 r^2 + K2 r^4 + K3 r^6) + P2 (r^2 + 2 y^2) + 2 P1 x y)            Brown (1971)

b1 is the affinity, b2 the shear. In `brown-scale-first` the scale b1 acts on the measured u itself, about the origin of
the image coordinates, so b1 shifts the principal point by b1 u.
"""

from jaxbundle.camera.collinearity import Vector, central_projection
from jaxbundle.camera.model import SENSOR, CameraModel, ImagePoint, reduced
from jaxbundle.geometry.rotation import Scalar

ORIENTATION = ("principal_distance", "x0", "y0")
DISTORTION = ("K1", "K2", "K3", "P1", "P2")


def radial_and_decentring(
    x: Scalar, y: Scalar, k1: Scalar, k2: Scalar, k3: Scalar, p1: Scalar, p2: Scalar, k4: Scalar = 0.0
) -> ImagePoint:
    """The function D(x, y): an image point with radial and decentring distortion (Brown 1971), and K4 r^8 if given."""
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
    return (
        x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y,
        y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y,
    )


def _distortion_free(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, s, y_axis = interior
    xs, ys = central_projection(photo_vector, c)
    return xs / s - (measured[0] - x0), ys / s - y_axis * (measured[1] - y0)


def _brown(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, k1, k2, k3, p1, p2, b1, b2, s, y_axis = interior
    xs, ys = central_projection(photo_vector, c)
    x, y = reduced(measured, x0, y0, s, y_axis)
    xc, yc = radial_and_decentring((1 + b1) * x + b2 * y, y, k1, k2, k3, p1, p2)
    return (xs - xc) / s, (ys - yc) / s


def _affine_last(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, k1, k2, k3, p1, p2, b1, b2, s, y_axis = interior
    xs, ys = central_projection(photo_vector, c)
    x2, y2 = radial_and_decentring(*reduced(measured, x0, y0, s, y_axis), k1, k2, k3, p1, p2)
    return (xs - (1 + b1) * x2 - b2 * y2) / s, (ys - y2) / s


def _scale_first(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, k1, k2, k3, p1, p2, b1, s, y_axis = interior
    xs, ys = central_projection(photo_vector, c)
    scaled = (1 + b1) * measured[0], measured[1]
    xc, yc = radial_and_decentring(*reduced(scaled, x0, y0, s, y_axis), k1, k2, k3, p1, p2)
    return (xs - xc) / s, (ys - yc) / s


DISTORTION_FREE = CameraModel("none", (*ORIENTATION, *SENSOR), _distortion_free)
BROWN = CameraModel("brown", (*ORIENTATION, *DISTORTION, "b1", "b2", *SENSOR), _brown)
BROWN_AFFINE_LAST = CameraModel("brown-affine-last", BROWN.elements, _affine_last)
BROWN_SCALE_FIRST = CameraModel("brown-scale-first", (*ORIENTATION, *DISTORTION, "b1", *SENSOR), _scale_first)
