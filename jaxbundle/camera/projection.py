"""From space to image: the image point of a photo vector, for any camera model."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel, ImagePoint, Residual
from jaxbundle.geometry.rotation import Scalar

# Newton steps: a distortion of the projection needs one, a strong correction of the measurement about six
NEWTON_STEPS = 10


def projection(
    model: CameraModel, interior: tuple[Scalar, ...], photo_vector: Vector, steps: int = NEWTON_STEPS
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Image coordinates with zero residual for a photo vector, in the unit of the rays.

    By Newton's method from the principal point, so any camera model can be used; one step is exact for models that do
    not correct the measurement.

    Args:
        model: camera model of photographs.
        interior: its elements, each a number or an array.
        photo_vector: p_x, p_y, p_z, arrays of any one shape.
        steps: number of steps of Newton's method.
    """
    one, zero = jnp.ones_like(photo_vector[0]), jnp.zeros_like(photo_vector[0])
    elements: dict[str, Any] = dict(zip(model.elements, interior, strict=False))
    start = (elements.get("x0", 0.0) * one, elements.get("y0", 0.0) * one)

    def residual(x: Array, y: Array) -> Residual:
        return model.residual(interior, photo_vector, (x, y))

    def step(_: Int[Array, ""], measured: ImagePoint) -> ImagePoint:
        (vx, vy), (xx, yx) = jax.jvp(residual, measured, (one, zero))
        _, (xy, yy) = jax.jvp(residual, measured, (zero, one))
        determinant = xx * yy - xy * yx
        return measured[0] - (yy * vx - xy * vy) / determinant, measured[1] - (xx * vy - yx * vx) / determinant

    x, y = jax.lax.fori_loop(0, steps, step, start)
    return x, y
