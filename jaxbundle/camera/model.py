"""Camera models: what lies between the photo vector and the residual of a measured image point.

A model is a name, the names of its interior elements and one differentiable function of scalars

    residual(interior, photo_vector, measured) -> (v_x, v_y),        v = computed - observed, unit of the rays

It needs no derivative: autodiff gives it. Two forms are equally good:

    backward (photogrammetric)    the measurement is corrected, v is formed in the corrected plane
    forward (computer vision)     the projection is distorted, v is formed in the image

    none     v = ((xs, ys) - (x, y)) / s
    brown    v = ((xs, ys) - D((1 + b1) x + b2 y, y)) / s                                 backward
    bal      v = f (1 + k1 r^2 + k2 r^4) (xn, yn) - (x, y),  r^2 = xn^2 + yn^2            forward

    (xs, ys) = -c (p_x, p_y) / p_z,  (xn, yn) the same for c = 1
    (x, y) = ((u - x0) s, +-(v - y0) s)    reduced measurement, s = pixel_size; y_axis = -1 where v points down
    D(x, y) = (x (1 + K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 x^2) + 2 P2 x y,
               y (1 + K1 r^2 + K2 r^4 + K3 r^6) + P2 (r^2 + 2 y^2) + 2 P1 x y)            Brown (1971)

Affinity b1 and shear b2 act before the distortion. `pixel_size` and `y_axis` are interior elements like the others, but
always held.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import jax.numpy as jnp

from jaxbundle.camera.collinearity import Vector, central_projection
from jaxbundle.geometry.rotation import Scalar

ImagePoint = tuple[Scalar, Scalar]
SENSOR = ("pixel_size", "y_axis")


@dataclass(frozen=True)
class CameraModel:
    """A camera model by name; `elements` orders the scalars that `residual` takes as `interior`."""

    name: str
    elements: tuple[str, ...]
    residual: Callable[[tuple[Scalar, ...], Vector, ImagePoint], ImagePoint]

    @property
    def estimable(self) -> tuple[str, ...]:
        """Elements that an adjustment may estimate."""
        return tuple(name for name in self.elements if name not in SENSOR)


def radial_and_decentring(
    x: Scalar, y: Scalar, k1: Scalar, k2: Scalar, k3: Scalar, p1: Scalar, p2: Scalar
) -> ImagePoint:
    """D(x, y): an image point and its radial and decentring distortion (Brown 1971)."""
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
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
    x, y = (measured[0] - x0) * s, y_axis * (measured[1] - y0) * s
    xc, yc = radial_and_decentring((1 + b1) * x + b2 * y, y, k1, k2, k3, p1, p2)
    return (xs - xc) / s, (ys - yc) / s


def _bal(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
    f, k1, k2 = interior
    x, y = central_projection(photo_vector, 1.0)
    r2 = x * x + y * y
    scale = f * (1 + r2 * (k1 + r2 * k2))
    return scale * x - measured[0], scale * y - measured[1]


DISTORTION_FREE = CameraModel("none", ("principal_distance", "x0", "y0", *SENSOR), _distortion_free)
BROWN = CameraModel(
    "brown", ("principal_distance", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "b1", "b2", *SENSOR), _brown
)
BAL = CameraModel("bal", ("principal_distance", "k1", "k2"), _bal)
CAMERA_MODELS = {model.name: model for model in (DISTORTION_FREE, BROWN, BAL)}


@cache
def mixture(models: tuple[CameraModel, ...]) -> CameraModel:
    """One model for cameras of several: an interior padded with ones, then its number in `kinds`.

    Every ray is computed with every kind and one result is chosen; cameras of a single kind give that kind itself.
    """
    kinds = tuple(dict.fromkeys(models))
    if len(kinds) == 1:
        return kinds[0]
    length = max(len(model.elements) for model in kinds)

    def residual(interior: tuple[Scalar, ...], photo_vector: Vector, measured: ImagePoint) -> ImagePoint:
        x, y = 0.0 * measured[0], 0.0 * measured[1]
        for k, model in enumerate(kinds):
            chosen = interior[length] == k
            # another kind's elements might be a 0 to divide by here, and 0 times the derivative of that is no 0
            own = tuple(jnp.where(chosen, element, 1.0) for element in interior[: len(model.elements)])
            x_k, y_k = model.residual(own, photo_vector, measured)
            x, y = jnp.where(chosen, x_k, x), jnp.where(chosen, y_k, y)
        return x, y

    elements = (*(f"element {k + 1}" for k in range(length)), "kind")
    return CameraModel(" | ".join(model.name for model in kinds), elements, residual)
