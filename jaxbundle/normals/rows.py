"""Rows of the design matrix, by autodiff of the image equation and of the observation kinds.

    v = A dt + B dX        A: six elements of the image (X0, Y0, Z0, three angles), then the estimated interior elements
                           B: X, Y, Z of the object point

What depends on the image alone, the rotation matrix, is differentiated once an image. The photo vector stands between
the camera and everything else: two vector-Jacobian products a ray give the rows of the camera, the chain rule the rest.
All quantities are scalars, which may be arrays of any one shape.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Group, touched_values, weighted
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.camera.model import CameraModel, ImagePoint
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.numerics.stored import stored


class RayRows(NamedTuple):
    """Weighted residual and rows of one image point: index 0 is x, index 1 is y."""

    residual: ImagePoint
    image: tuple[list[Scalar], list[Scalar]]
    point: tuple[Vector, Vector]


class ImageScalars(NamedTuple):
    """What a ray takes from its image: rotation, its derivatives by three angles, centre, all interior elements."""

    rotation: Rotation
    rotation_derivatives: tuple[Rotation, Rotation, Rotation]
    centre: Vector
    interior: tuple[Scalar, ...]


def image_equation(
    model: CameraModel,
    rotation: Rotation,
    centre: Vector,
    interior: tuple[Scalar, ...],
    point: Vector,
    measured: ImagePoint,
    zero: Int[Array, ""] | None = None,
) -> ImagePoint:
    """Residual of an image point as a function of everything it depends on.

    With a `zero`, photo vector and residual are `stored`, and so are their derivatives, of which there are many.
    """
    vector = photo_vector(rotation, centre, point)
    if zero is None:
        return model.residual(interior, vector, measured)
    return stored(model.residual(interior, stored(vector, zero), measured), zero)


class PhotoVector(NamedTuple):
    """The photo vector of a ray and its derivatives by three angles; with each the transposed derivative by the object
    point, that takes a gradient by the photo vector to one by X, Y, Z."""

    value: Vector
    to_point: Callable[[Vector], Vector]
    turned: list[Vector]
    turned_to_point: list[Callable[[Vector], Vector]]


def photo_vector_derivatives(image: ImageScalars, point: Vector) -> PhotoVector:
    """Of one ray."""

    def with_transposed(of_point: Callable[[Vector], Vector]) -> tuple[Vector, Callable[[Vector], Vector]]:
        value, transposed = jax.vjp(of_point, point)
        return value, lambda gradient: transposed(gradient)[0]

    def along(turn: Rotation) -> Callable[[Vector], Vector]:
        return lambda x: jax.jvp(lambda r: photo_vector(r, image.centre, x), (image.rotation,), (turn,))[1]

    value, to_point = with_transposed(lambda x: photo_vector(image.rotation, image.centre, x))
    turned = [with_transposed(along(turn)) for turn in image.rotation_derivatives]
    return PhotoVector(value, to_point, [t for t, _ in turned], [back for _, back in turned])


def camera_equation(
    model: CameraModel, columns: tuple[int, ...], image: ImageScalars, measured: ImagePoint
) -> Callable[[Vector, tuple[Scalar, ...]], ImagePoint]:
    """Residual of an image point as a function of photo vector and estimated interior elements."""

    def equation(vector: Vector, estimated: tuple[Scalar, ...]) -> ImagePoint:
        interior = list(image.interior)
        for column, value in zip(columns, estimated, strict=True):
            interior[column] = value
        return model.residual(tuple(interior), vector, measured)

    return equation


def ray_rows(
    model: CameraModel,
    columns: tuple[int, ...],
    image: ImageScalars,
    point: Vector,
    measured: ImagePoint,
    weights: ImagePoint,
) -> RayRows:
    """Residual and rows of a ray, times the square roots of its weights; `columns`: estimated interior elements."""
    p = photo_vector_derivatives(image, point)
    estimated = tuple(image.interior[column] for column in columns)
    v, transposed = jax.vjp(camera_equation(model, columns, image, measured), p.value, estimated)
    zero = jnp.zeros_like(weights[0])
    image_rows, point_rows = [], []
    for unit in ((weights[0], zero), (zero, weights[1])):
        by_vector, by_interior = transposed(unit)
        by_point = p.to_point(by_vector)
        # the equation contains X - X0 only
        image_rows.append([*(-b for b in by_point), *(chained(by_vector, t) for t in p.turned), *by_interior])
        point_rows.append(by_point)
    residual = v[0] * weights[0], v[1] * weights[1]
    return RayRows(residual, (image_rows[0], image_rows[1]), (point_rows[0], point_rows[1]))


def chained(gradient: tuple[Scalar, ...], direction: tuple[Scalar, ...]) -> Scalar:
    """Derivative along a direction from the derivatives by the elements."""
    return sum(g * d for g, d in zip(gradient, direction, strict=True))


class GroupRows(NamedTuple):
    """Weighted residuals and rows of a group; one entry of `rows` for each touched entity."""

    residuals: Float[Array, "component member"]
    rows: tuple[Float[Array, "component parameter member"], ...]


def group_rows(
    group: Group,
    unknowns: Unknowns,
    rotation_derivatives: Float[Array, "9 3 image"],
    columns: tuple[int, ...],
) -> GroupRows:
    """Residuals and rows of a group of observations, times the square roots of their weights."""
    touches, index, weights = group.kind.touches, group.indices, group.weights
    touched = tuple(touched_values(unknowns, kind, i) for kind, i in zip(touches, index, strict=True))

    def residual(*touched: Any) -> tuple[Scalar, ...]:
        return group.kind.residuals(touched, tuple(group.values), tuple(group.constants))

    v, transposed = jax.vjp(residual, *touched)
    rows: list[list[Array]] = [[] for _ in touches]
    for k in range(len(v)):
        if weights.ndim == 3:
            cotangent = tuple(weights[k])
        else:
            cotangent = tuple(weights[j] if j == k else jnp.zeros_like(weights[j]) for j in range(len(v)))
        for entity, (kind, g) in enumerate(zip(touches, transposed(cotangent), strict=True)):
            if kind == "image":
                turns = rotation_derivatives[:, :, index[entity]]
                g = (*g[0], *(chained(g[1], tuple(turns[:, a])) for a in range(3)))
            elif kind == "camera":
                g = tuple(g[column] for column in columns)
            elif kind == "parameter":
                g = (g,)
            rows[entity].append(jnp.stack(g) if g else jnp.zeros((0, group.values.shape[1])))
    return GroupRows(weighted(jnp.stack(v), group), tuple(jnp.stack(row) for row in rows))
