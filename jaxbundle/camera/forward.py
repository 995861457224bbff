"""Camera models that distort the projection; the residual is formed in the image.

    brown-forward    v = D(xs, ys) / s - (x, y) / s
    aicon            v = ((xs + dx, ys + dy) - (x, y)) / s,  r^2 = xs^2 + ys^2
                     dr = A1 (r^2 - R0^2) + A2 (r^4 - R0^4) + A3 (r^6 - R0^6)
                     dx = xs dr + B1 (r^2 + 2 xs^2) + 2 B2 xs ys + C1 xs + C2 ys
                     dy = ys dr + B2 (r^2 + 2 ys^2) + 2 B1 xs ys
    metashape        v = (f x' + b1 x' + b2 y', f y') - (u - x0, v - y0),  (x', y') = D(xn, -yn), y' and v down,
                     D with K4 r^8
    bal              v = f (1 + k1 r^2 + k2 r^4) (xn, yn) - (x, y),  r^2 = xn^2 + yn^2

D as in `brown`. Coefficients of `metashape` and `bal` belong to c = 1; their f is in the unit of the rays. The residual
of `metashape` is converted to y up at the end, as for all models. Sources: aicon: balanced radial distortion of
Luhmann et al. (2014), R0 is the second zero of the radial curve, always fixed; metashape: Agisoft's manual, appendix
"camera models", without its P3, P4; bal: Agarwal et al. (2010).
"""

from jaxbundle.camera.brown import DISTORTION, ORIENTATION, radial_and_decentring
from jaxbundle.camera.collinearity import Vector, central_projection
from jaxbundle.camera.model import SENSOR, CameraModel, ImagePoint, reduced
from jaxbundle.geometry.rotation import Scalar


def _brown_forward(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, k1, k2, k3, p1, p2, s, y_axis = interior
    xd, yd = radial_and_decentring(*central_projection(photo_vector, c), k1, k2, k3, p1, p2)
    return xd / s - (measured[0] - x0), yd / s - y_axis * (measured[1] - y0)


def _aicon(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2, r0, s, y_axis = interior
    xs, ys = central_projection(photo_vector, c)
    r2, z2 = xs * xs + ys * ys, r0 * r0
    dr = r2 * (a1 + r2 * (a2 + r2 * a3)) - z2 * (a1 + z2 * (a2 + z2 * a3))
    dx = xs * dr + b1 * (r2 + 2 * xs * xs) + 2 * b2 * xs * ys + c1 * xs + c2 * ys
    dy = ys * dr + b2 * (r2 + 2 * ys * ys) + 2 * b1 * xs * ys
    x, y = reduced(measured, x0, y0, s, y_axis)
    return (xs + dx - x) / s, (ys + dy - y) / s


def _metashape(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, x0, y0, k1, k2, k3, p1, p2, b1, b2, k4, y_axis = interior
    xn, yn = central_projection(photo_vector, 1.0)
    xd, yd = radial_and_decentring(xn, -yn, k1, k2, k3, p1, p2, k4)
    x, y = reduced(measured, x0, y0, 1.0, y_axis)
    return f * xd + b1 * xd + b2 * yd - x, -f * yd - y


def _bal(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, k1, k2 = interior
    x, y = central_projection(photo_vector, 1.0)
    r2 = x * x + y * y
    scale = f * (1 + r2 * (k1 + r2 * k2))
    return scale * x - measured[0], scale * y - measured[1]


BROWN_FORWARD = CameraModel("brown-forward", (*ORIENTATION, *DISTORTION, *SENSOR), _brown_forward)
AICON = CameraModel("aicon", (*ORIENTATION, "A1", "A2", "A3", "B1", "B2", "C1", "C2", "R0", *SENSOR), _aicon)
METASHAPE = CameraModel("metashape", (*ORIENTATION, *DISTORTION, "b1", "b2", "K4", "y_axis"), _metashape)
BAL = CameraModel("bal", ("principal_distance", "k1", "k2"), _bal)
