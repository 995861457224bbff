"""Camera models: functions from the photo vector to the residual of a measured image point.

A model is a name, the names of its interior elements and one differentiable function of scalars

    residual(interior, photo_vector, measured) -> (v_x, v_y),        v = computed - observed, unit of the rays, y up

Derivatives are computed by autodiff. Two forms are possible:

    backward (photogrammetric)    the measurement is corrected, v is formed in the corrected plane
    forward (computer vision)     the projection is distorted, v is formed in the image

Notation of all models:

    (xs, ys) = -c (p_x, p_y) / p_z,  (xn, yn) the same for c = 1
    (x, y) = ((u - x0) s, +-(v - y0) s)    reduced measurement, s = pixel_size; y_axis = -1 if v points down

`pixel_size` and `y_axis` are interior elements like the others, but always fixed, like all of `HELD`.

Sensors other than photographs differ only in the number of residuals. An independent model measures a point with
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
HELD = (*SENSOR, *CORRECTIONS, "grid_base", "R0")  # they define a model or its unit, or are known


@dataclass(frozen=True)
class CameraModel:
    """A camera model, or another sensor that measures points in its own axes.

    Example:
        >>> model = jb.cameras.CAMERA_MODELS["brown"]
        >>> model.name, model.components
        ('brown', 2)
    """

    name: str
    elements: tuple[str, ...]
    """Names of the scalars in the argument `interior` of `residual`."""
    residual: Callable[..., Residual]
    """Differentiable function (interior, photo vector, measured numbers) -> residuals."""
    components: int = 2
    """Number of residuals of a ray, each with a sigma."""
    numbers: int = 2
    """Number of measured numbers of a ray: equal to the residuals, or more with additional constants."""

    @property
    def photographs(self) -> bool:
        """Whether two coordinates of a direction are measured: a point is then in front of or behind the camera."""
        return self.components == 2

    @property
    def estimable(self) -> tuple[str, ...]:
        """Names of the elements that an adjustment may estimate."""
        return tuple(name for name in self.elements if name not in HELD)


def model_defect(model: CameraModel) -> str:
    """The problem of an invalid camera model, as the end of a sentence; "" for a valid one. A model is tried once."""
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
    except TypeError:  # static arguments of a program must have a hash
        return "cannot be hashed: its residual is an object that contains arrays or lists"


@cache
def _tried(model: CameraModel) -> str:
    return defect(model.residual, ((0.0,) * len(model.elements), (0.0,) * 3, (0.0,) * model.numbers), model.components)


def reduced(measured: ImagePoint, x0: Scalar, y0: Scalar, pixel_size: Scalar, y_axis: Scalar) -> ImagePoint:
    """The reduced measurement (x, y) from the principal point, y up, in the unit of the principal distance."""
    return (measured[0] - x0) * pixel_size, y_axis * (measured[1] - y0) * pixel_size


@dataclass(frozen=True)
class _Selected:
    """The residual of a mixture; an object with a name in this module, so that its programs can be cached.

    `length`: number of interior elements before the index in `kinds`.
    """

    kinds: tuple[CameraModel, ...]
    length: int

    def __call__(self, interior: tuple[Scalar, ...], photo_vector: Vector, measured: Measured) -> Residual:
        v: Residual = (0.0 * measured[0],) * self.kinds[0].components
        for k, model in enumerate(self.kinds):
            chosen = interior[self.length] == k
            # elements of another kind might give a division by 0 here, or be coefficients of a high power of the
            # measured coordinates; and 0 times an infinite derivative is not 0
            own = tuple(jnp.where(chosen, element, 1.0) for element in interior[: len(model.elements)])
            point = tuple(jnp.where(chosen, number, 0.0) for number in measured)
            of_kind = model.residual(own, photo_vector, point)
            v = tuple(jnp.where(chosen, new, old) for new, old in zip(of_kind, v, strict=True))
        return v


@cache
def mixture(models: tuple[CameraModel, ...]) -> CameraModel:
    """One model for cameras with different models: interior elements padded with ones, then the index in `kinds`.

    Each ray is computed with all kinds and one result is selected; for a single kind this kind is returned.

    Raises: ValueError for sensors with different numbers of residuals or measured numbers.
    """
    kinds = tuple(dict.fromkeys(models))
    if len(kinds) == 1:
        return kinds[0]
    length = max(len(model.elements) for model in kinds)

    components, numbers = {model.components for model in kinds}, {model.numbers for model in kinds}
    if len(components) > 1 or len(numbers) > 1:
        raise ValueError(f"sensors of different kinds in one block: {', '.join(model.name for model in kinds)}")

    elements = (*(f"element {k + 1}" for k in range(length)), "kind")
    name = " | ".join(model.name for model in kinds)
    return CameraModel(name, elements, _Selected(kinds, length), components.pop(), numbers.pop())
