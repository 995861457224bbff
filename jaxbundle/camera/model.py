"""Camera models: what lies between the photo vector and the residual of a measured image point.

A model is a name, the names of its interior elements and one differentiable function of scalars

    residual(interior, photo_vector, measured) -> (v_x, v_y),        v = computed - observed, unit of the rays, y up

It needs no derivative: autodiff gives it. Two forms are equally good:

    backward (photogrammetric)    the measurement is corrected, v is formed in the corrected plane
    forward (computer vision)     the projection is distorted, v is formed in the image

Notation of all models:

    (xs, ys) = -c (p_x, p_y) / p_z,  (xn, yn) the same for c = 1
    (x, y) = ((u - x0) s, +-(v - y0) s)    reduced measurement, s = pixel_size; y_axis = -1 where v points down

`pixel_size` and `y_axis` are interior elements like the others, but always held, as are all of `HELD`.

A sensor that is not a photograph differs in the number of its residuals only. An independent model sees a point in
three coordinates, with the scale as its interior element:

    residual((scale,), p, (x, y, z)) -> (scale p_x - x, scale p_y - y, scale p_z - z)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import jax.numpy as jnp

from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.numerics.trial import defect

ImagePoint = tuple[Scalar, Scalar]
Measured = tuple[Scalar, ...]
Residual = tuple[Scalar, ...]
SENSOR = ("pixel_size", "y_axis")
CORRECTIONS = ("refraction", "earth_curvature")
HELD = (*SENSOR, *CORRECTIONS, "grid_base", "R0")  # they define a model or its unit, or are known beforehand


@dataclass(frozen=True)
class CameraModel:
    """A camera model, or another sensor that sees points in axes of its own."""

    name: str
    elements: tuple[str, ...]
    """Names of the scalars that `residual` takes as `interior`."""
    residual: Callable[..., Residual]
    """(interior, photo vector, measured numbers) -> residuals, differentiable."""
    components: int = 2
    """Residuals of a ray, each with a sigma."""
    numbers: int = 2
    """Measured numbers of a ray: as many as residuals, or more where constants stand behind them."""

    @property
    def photographs(self) -> bool:
        """Whether a direction is measured, by two coordinates: a point then lies before or behind the camera."""
        return self.components == 2

    @property
    def estimable(self) -> tuple[str, ...]:
        """Elements that an adjustment may estimate."""
        return tuple(name for name in self.elements if name not in HELD)


def model_defect(model: CameraModel) -> str:
    """What keeps a camera model from being one, as the end of a sentence; "" if nothing. A model is tried once."""
    elements = model.elements
    if not isinstance(model.name, str):
        return f"has a name of type {type(model.name).__name__}, not a string"
    if not isinstance(elements, tuple) or not all(isinstance(name, str) for name in elements):
        return f"has elements of type {type(elements).__name__}, not a tuple of names"
    if len(set(elements)) < len(elements):
        return f"names an element twice: {', '.join(elements)}"
    if not callable(model.residual):
        return f"has a residual of type {type(model.residual).__name__}, not a function"
    try:
        return _tried(model)
    except TypeError:  # what is static in a program must have a hash
        return "cannot be hashed: its residual is an object that holds arrays or lists"


@cache
def _tried(model: CameraModel) -> str:
    return defect(model.residual, ((0.0,) * len(model.elements), (0.0,) * 3, (0.0,) * model.numbers), model.components)


def reduced(measured: ImagePoint, x0: Scalar, y0: Scalar, pixel_size: Scalar, y_axis: Scalar) -> ImagePoint:
    """(x, y): a measured point from the principal point, y up, unit of the principal distance."""
    return (measured[0] - x0) * pixel_size, y_axis * (measured[1] - y0) * pixel_size


@cache
def mixture(models: tuple[CameraModel, ...]) -> CameraModel:
    """One model for cameras of several: an interior padded with ones, then its number in `kinds`.

    Every ray is computed with every kind and one result is chosen; cameras of a single kind give that kind itself.

    Raises: ValueError for sensors that differ in the number of their residuals or measured numbers.
    """
    kinds = tuple(dict.fromkeys(models))
    if len(kinds) == 1:
        return kinds[0]
    length = max(len(model.elements) for model in kinds)

    components, numbers = {model.components for model in kinds}, {model.numbers for model in kinds}
    if len(components) > 1 or len(numbers) > 1:
        raise ValueError(f"sensors of different kinds in one block: {', '.join(model.name for model in kinds)}")

    def residual(interior: tuple[Scalar, ...], photo_vector: Vector, measured: Measured) -> Residual:
        v: Residual = (0.0 * measured[0],) * kinds[0].components
        for k, model in enumerate(kinds):
            chosen = interior[length] == k
            # another kind's elements might be a 0 to divide by here, or coefficients of a high power of the measured
            # coordinates, and 0 times the derivative of what is not finite is no 0
            own = tuple(jnp.where(chosen, element, 1.0) for element in interior[: len(model.elements)])
            point = tuple(jnp.where(chosen, number, 0.0) for number in measured)
            of_kind = model.residual(own, photo_vector, point)
            v = tuple(jnp.where(chosen, new, old) for new, old in zip(of_kind, v, strict=True))
        return v

    elements = (*(f"element {k + 1}" for k in range(length)), "kind")
    name = " | ".join(model.name for model in kinds)
    return CameraModel(name, elements, residual, components.pop(), numbers.pop())
