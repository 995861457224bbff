"""Atmospheric refraction and earth curvature for any camera model, as corrections of the photo vector.

    p_xy -> p_xy (1 + K (1 + t^2) - E t^2),    t^2 = (p_x^2 + p_y^2) / p_z^2 = (r / c)^2

Refraction. n sin z is constant along a ray through a layered atmosphere. So a ray that arrives at the camera at the
angle z from the vertical is steeper at lower heights, by (n - n_camera) tan z. The straight line to the point is
steeper than the arriving ray by the mean of this, K tan z: the point appears too far OUT, dz = K tan z, on the image

    dr = c dz / cos^2 z = K (r + r^3 / c^2).

Earth curvature. The object system is a map: heights from the curved sea level, positions along it. A point at the
distance D from the nadir lies D^2 / 2R below the horizontal plane of the nadir, so it is by D^2 / 2R further below the
camera than its height indicates: it appears too far IN, with D = H r / c on the image

    dr = -H r^3 / (2 R c^2),    E = H / 2R,    H the flying height above ground.

Both are valid for vertical photographs with the usual tilts: t is measured from the camera's axis. Blocks in a
geocentric or tangential system need no correction of earth curvature.

Kraus (2007); Manual of Photogrammetry (ASPRS 2004); both terms follow from the two derivations above.
"""

import math
from functools import cache

from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CORRECTIONS, CameraModel, Measured, Residual
from jaxbundle.geometry.rotation import Scalar

EARTH_RADIUS = 6_371_000.0  # m, mean radius (2 a + b) / 3 of the ellipsoid of IUGG, to the km
ATMOSPHERE = 100_000.0  # m: above this there is no atmosphere; a larger flying height is in another unit


@cache
def with_corrections(model: CameraModel) -> CameraModel:
    """The model with two additional fixed interior elements: `refraction` K (rad) and `earth_curvature` H / 2R.

    Example:
        >>> jb.cameras.with_corrections(jb.cameras.CAMERA_MODELS["none"]).elements
        ('principal_distance', 'x0', 'y0', 'pixel_size', 'y_axis', 'refraction', 'earth_curvature')
    """

    def residual(interior: tuple[Scalar, ...], photo_vector: Vector, measured: Measured) -> Residual:
        *own, refraction, earth_curvature = interior
        px, py, pz = photo_vector
        t2 = (px * px + py * py) / (pz * pz)
        scale = 1 + refraction * (1 + t2) - earth_curvature * t2
        return model.residual(tuple(own), (scale * px, scale * py, pz), measured)

    elements = (*model.elements, *CORRECTIONS)
    return CameraModel(f"{model.name} with corrections", elements, residual, model.components, model.numbers)


def refraction_coefficient(flying_height: float, ground_height: float) -> float:
    """The coefficient K in rad, from heights above sea level in m, in a standard atmosphere (ARDC 1959; Bertram 1966).

    K = 0.00241 (H / (H^2 - 6 H + 250) - h / (h^2 - 6 h + 250) h / H), H and h in km. It is an approximation, best for
    low ground. The table compares it with the mean of n - n_camera in the standard atmosphere (Schut 1969), unit 1e-6
    rad:

        H, h      1, 0    3, 0    6, 0    9, 0    3, 1    6, 2    9, 3
        K          9.8    30.0    57.8    78.3    26.7    51.2    68.3
        mean n    12.7    34.3    58.9    75.3    22.3    37.1    45.8

    Raises: ValueError for invalid heights.

    Example:
        >>> round(1e6 * jb.cameras.refraction_coefficient(3500.0, 500.0), 1)
        34.3
    """
    _require_heights(flying_height, ground_height)
    H, h = flying_height / 1000, ground_height / 1000
    return 0.00241 * (H / (H * H - 6 * H + 250) - h / (h * h - 6 * h + 250) * h / H)


def curvature_coefficient(flying_height: float, ground_height: float) -> float:
    """The coefficient H / 2R, from heights above sea level in metres; H is the flying height above ground.

    Raises: ValueError for invalid heights.

    Example:
        >>> round(jb.cameras.curvature_coefficient(3500.0, 500.0), 6)
        0.000235
    """
    _require_heights(flying_height, ground_height)
    return (flying_height - ground_height) / (2 * EARTH_RADIUS)


def _require_heights(flying_height: float, ground_height: float) -> None:
    if not (math.isfinite(flying_height) and math.isfinite(ground_height)):
        raise ValueError(f"flying_height {flying_height} and ground_height {ground_height} are not finite numbers")
    if flying_height <= max(ground_height, 0.0):
        lower = "sea level" if ground_height < 0 else f"ground_height {ground_height}"
        raise ValueError(f"flying_height {flying_height} is not above {lower}")
    if flying_height > ATMOSPHERE:
        raise ValueError(f"flying_height {flying_height} is above the atmosphere")
