"""Additional parameters: orthogonal corrections of the measurement after Brown's distortion.

    v = ((xs, ys) - (x2, y2) - (dx, dy)) / s,    (x2, y2) = D(x, y),    (dx, dy) = sum of the corrections at (x2, y2)

On a grid of n x n image points, n = 3 (Ebner 1976) or 5 (Gruen 1978), whose outer points lie at +-b from the principal
point, b = `grid_base`, all products T_i(x) T_j(y), i, j < n, of the polynomials orthogonal on one line of the grid,

    n = 3    T = 1, x, x^2 - 2 b^2/3
    n = 5    T = 1, x, x^2 - b^2/2, x^3 - 17 b^2 x/20, x^4 - 31 b^2 x^2/28 + 9 b^4/70

represent any correction in dx at n^2 points, and in dy: 18 or 50 terms. Six are left out, because the orientation of
each image absorbs them: two shifts, scale, rotation and two tilts, (T2(x), x y) and (x y, T2(y)). Their terms are
    replaced by combinations orthogonal to them; 12 or 44 corrections remain:

    1    (x, -y)                  3    (-m T2(x), x y)            m = 2 (n = 3), 10/7 (n = 5): the ratio of the sums
    2    (y, x)                   4    (x y, -m T2(y))            of (x y)^2 and T2^2 over the grid
    5, 7, ...    (T_i(x) T_j(y), 0) for all other i, j, by i + j, then by i
    6, 8, ...    (0, T_j(x) T_i(y)), its mirror image

All are orthogonal to each other and to the six, as vectors over the grid. For n = 3 they are those of Ebner, in his
order:

    dx =  e1 x + e2 y - e3 (2 x^2 - 4 b^2/3) + e4 x y + e5 Y + e7 x Y + e9 y X + e11 X Y        X = x^2 - 2 b^2/3
    dy = -e1 y + e2 x + e3 x y - e4 (2 y^2 - 4 b^2/3) + e6 X + e8 y X + e10 x Y + e12 X Y       Y = y^2 - 2 b^2/3

His paper gives the count 18 - 6 and both conditions of orthogonality. Gruen's 44 follow from the same conditions
for 25 points; their order is defined here.

e_k and g_k have the unit of the principal distance to the power 1 - degree. `grid_base` is in that unit and always
fixed; a usual value is 0.4 of the longer side of the image format.

H. Ebner, Self calibrating block adjustment, Int. Arch. Photogrammetry 21 (III), Helsinki 1976.
A. W. Gruen, Accuracy, reliability and statistics in close-range photogrammetry, Inter-Congress Symposium of ISP
Commission V, Stockholm 1978.
"""

from typing import NamedTuple

from jaxbundle.camera.brown import DISTORTION, ORIENTATION, radial_and_decentring
from jaxbundle.camera.collinearity import Vector, central_projection
from jaxbundle.camera.model import SENSOR, CameraModel, ImagePoint, reduced
from jaxbundle.geometry.rotation import Scalar

GRID_SHARE = 0.4  # share of the longer side: the outer points of the grid are at 80 % of the distance to the edge


class Product(NamedTuple):
    """A term of a correction: factor T_i(x) T_j(y)."""

    factor: float
    i: int
    j: int


class Correction(NamedTuple):
    """One correction of both coordinates; None for an unchanged coordinate."""

    x: Product | None
    y: Product | None


def orthogonal_corrections(points: int) -> tuple[Correction, ...]:
    """The corrections on a grid of points x points, 3 or 5, in the order of their numbers."""
    ratio = {3: 2.0, 5: 10 / 7}[points]
    corrections = [
        Correction(Product(1.0, 1, 0), Product(-1.0, 0, 1)),
        Correction(Product(1.0, 0, 1), Product(1.0, 1, 0)),
        Correction(Product(-ratio, 2, 0), Product(1.0, 1, 1)),
        Correction(Product(1.0, 1, 1), Product(-ratio, 0, 2)),
    ]
    with_orientation = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1))
    others = [(i, j) for i in range(points) for j in range(points) if (i, j) not in with_orientation]
    for i, j in sorted(others, key=lambda pair: (sum(pair), pair)):
        corrections += [Correction(Product(1.0, i, j), None), Correction(None, Product(1.0, j, i))]
    return tuple(corrections)


def polynomials(points: int, x: Scalar, b: Scalar) -> tuple[Scalar, ...]:
    """The polynomials T_0 ... T_(points - 1) at x."""
    x2, b2 = x * x, b * b
    if points == 3:
        return 1.0, x, x2 - 2 * b2 / 3
    return (
        1.0,
        x,
        x2 - b2 / 2,
        x * (x2 - 17 * b2 / 20),
        x2 * (x2 - 31 * b2 / 28) + 9 * b2 * b2 / 70,
    )


def _model(name: str, letter: str, points: int) -> CameraModel:
    corrections = orthogonal_corrections(points)

    def residual(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
        c, x0, y0, k1, k2, k3, p1, p2, *coefficients, b, s, y_axis = interior
        xs, ys = central_projection(photo_vector, c)
        x, y = radial_and_decentring(*reduced(measured, x0, y0, s, y_axis), k1, k2, k3, p1, p2)
        along, up = polynomials(points, x, b), polynomials(points, y, b)
        for coefficient, (in_x, in_y) in zip(coefficients, corrections, strict=True):
            if in_x:
                x = x + coefficient * in_x.factor * along[in_x.i] * up[in_x.j]
            if in_y:
                y = y + coefficient * in_y.factor * along[in_y.i] * up[in_y.j]
        return (xs - x) / s, (ys - y) / s

    names = tuple(f"{letter}{k + 1}" for k in range(len(corrections)))
    return CameraModel(name, (*ORIENTATION, *DISTORTION, *names, "grid_base", *SENSOR), residual)


EBNER = _model("ebner", "e", 3)
GRUEN = _model("gruen", "g", 5)
