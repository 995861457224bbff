"""Rows of the design matrix and second derivatives of a ray, by autodiff of the image equation.

    v = A dt + B dX        A: six elements of the image (X0, Y0, Z0, three angles), then the estimated interior elements
                           B: X, Y, Z of the object point

The rotation matrix depends only on the image and is differentiated once per image. The photo vector separates the
camera from all other parts: one vector-Jacobian product per residual gives the rows of the camera, the chain rule the
    others. All quantities are scalars, which may be arrays of one shape.

The normal equations N = A^T P A neglect second derivatives of v^T P v / 2: H = N + sum of w^2 v d2v. For a ray,
with F = sum of w^2 v (w^2 v constant), a function of photo vector p and interior elements e, and p_X, p_a its
derivatives with respect to the object point and to the angles:

    F_XX = p_X^T F_pp p_X        F_Xa = p_X^T F_pp p_a + F_p p_Xa        F_Xe = p_X^T F_pe
                                 F_aa = p_a^T F_pp p_a + F_p p_aa        F_ae = p_a^T F_pe        F_ee

p contains only X - X0: derivatives for a projection centre are those for the point with opposite sign. F_p p_aa
comes from the second derivatives of the rotation matrix, equal for all rays of an image, and is added to their sums.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Observations
from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.camera.model import CameraModel, Measured, Residual
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.normals.point_blocks import Symmetric
from jaxbundle.numerics.stored import stored

Lower = list[list[Scalar]]  # row indices of a lower triangle


Image = tuple[Rotation, Vector, tuple[Scalar, ...]]  # rotation, projection centre, interior elements


class ImageScalars(NamedTuple):
    """Values of a ray's image: rotation, its derivatives with respect to three angles, centre, interior."""

    rotation: Rotation
    rotation_derivatives: tuple[Rotation, Rotation, Rotation]
    centre: Vector
    interior: tuple[Scalar, ...]


class Ray(NamedTuple):
    """A ray: its image, its point, measured numbers, and the square roots of the weights of its residuals."""

    image: ImageScalars
    point: Vector
    measured: Measured
    weights: tuple[Scalar, ...]


class RayRows(NamedTuple):
    """Weighted residuals of a ray, each with its row for the unknowns of the image and for X, Y, Z."""

    residual: Residual
    image: list[list[Scalar]]
    point: list[Vector]


class RayCurvature(NamedTuple):
    """Second derivatives of F, without F_p p_aa."""

    point: Symmetric
    """With respect to the point."""
    mixed: list[Any]
    """With respect to the unknowns of the image and the point."""
    image: Lower
    """With respect to the unknowns of the image."""
    rotation: Rotation
    """Gradient of F with respect to the elements of the rotation matrix."""


class PhotoVector(NamedTuple):
    """The photo vector of a ray and its derivatives with respect to three angles.

    Each has the transposed derivative with respect to the object point, which converts a gradient for the photo vector
    to one for X, Y, Z.
    """

    value: Vector
    to_point: Callable[[Vector], Vector]
    turned: list[Vector]
    turned_to_point: list[Callable[[Vector], Vector]]


def image_equation(
    model: CameraModel, image: Image, point: Vector, measured: Measured, zero: Int[Array, ""] | None = None
) -> Residual:
    """Residuals of a ray as a function of all their arguments.

    With a `zero`, photo vector and residuals are `stored`, and also their numerous derivatives.
    """
    rotation, centre, interior = image
    vector = photo_vector(rotation, centre, point)
    if zero is None:
        return model.residual(interior, vector, measured)
    return stored(model.residual(interior, stored(vector, zero), measured), zero)


def photo_vector_derivatives(image: ImageScalars, point: Vector) -> PhotoVector:
    """The photo vector of one ray with its derivatives."""

    def with_transposed(of_point: Callable[[Vector], Vector]) -> tuple[Vector, Callable[[Vector], Vector]]:
        value, transposed = jax.vjp(of_point, point)
        return value, lambda gradient: transposed(gradient)[0]

    def along(turn: Rotation) -> Callable[[Vector], Vector]:
        return lambda x: jax.jvp(lambda r: photo_vector(r, image.centre, x), (image.rotation,), (turn,))[1]

    value, to_point = with_transposed(lambda x: photo_vector(image.rotation, image.centre, x))
    turned = [with_transposed(along(turn)) for turn in image.rotation_derivatives]
    return PhotoVector(value, to_point, [t for t, _ in turned], [back for _, back in turned])


def camera_equation(o: Observations, ray: Ray) -> Callable[[Vector, tuple[Scalar, ...]], Residual]:
    """Residuals of a ray as a function of photo vector and estimated interior elements."""

    def equation(vector: Vector, estimated: tuple[Scalar, ...]) -> Residual:
        interior = list(ray.image.interior)
        for column, value in zip(o.columns, estimated, strict=True):
            interior[column] = value
        return o.model.residual(tuple(interior), vector, ray.measured)

    return equation


def ray_rows(o: Observations, ray: Ray) -> RayRows:
    """Residuals and rows of a ray, times the square roots of its weights."""
    p = photo_vector_derivatives(ray.image, ray.point)
    estimated = tuple(ray.image.interior[column] for column in o.columns)
    v, transposed = jax.vjp(camera_equation(o, ray), p.value, estimated)
    image_rows, point_rows = [], []
    for k in range(len(ray.weights)):
        by_vector, by_interior = transposed(
            tuple(w if j == k else jnp.zeros_like(w) for j, w in enumerate(ray.weights))
        )
        by_point = p.to_point(by_vector)
        # the equation contains only X - X0
        image_rows.append([*(-b for b in by_point), *(chained(by_vector, t) for t in p.turned), *by_interior])
        point_rows.append(by_point)
    return RayRows(tuple(r * w for r, w in zip(v, ray.weights, strict=True)), image_rows, point_rows)


def chained(gradient: tuple[Scalar, ...], direction: tuple[Scalar, ...]) -> Scalar:
    """Directional derivative from the derivatives with respect to the elements."""
    return sum(g * d for g, d in zip(gradient, direction, strict=True))


def ray_curvature(o: Observations, ray: Ray, zero: Int[Array, ""]) -> RayCurvature:
    """Second derivatives of F of one ray; `zero`: see `stored`."""
    p = photo_vector_derivatives(ray.image, ray.point)
    p = p._replace(value=stored(p.value, zero), turned=stored(p.turned, zero))
    at = *p.value, *(ray.image.interior[column] for column in o.columns)
    (f1, f2, f3, *_), lower = stored(_by_camera(camera_equation(o, ray), at, ray.weights), zero)
    second = [[lower[max(i, j)][min(i, j)] for j in range(len(at))] for i in range(len(at))]
    to_point = [p.to_point((row[0], row[1], row[2])) for row in second]
    turned = [[chained(t, column) for column in zip(*second[:3], strict=True)] for t in p.turned]
    to_point, turned = stored((to_point, [tuple(row) for row in turned]), zero)

    by_point = [p.to_point((to_point[0][j], to_point[1][j], to_point[2][j])) for j in range(3)]
    by_angles = []
    for row, back in zip(turned, p.turned_to_point, strict=True):
        bent = back((f1, f2, f3))
        by_angles.append([a + b for a, b in zip(p.to_point((row[0], row[1], row[2])), bent, strict=True)])
    of_image = [list(by_point[i][: i + 1]) for i in range(3)]
    for i in range(3):
        of_image.append([*(-x for x in by_angles[i]), *(chained(turned[i][:3], t) for t in p.turned[: i + 1])])
    for k in range(3, len(at)):
        of_image.append([*(-x for x in to_point[k]), *(row[k] for row in turned), *lower[k][3:]])
    mixed = [*([-x for x in row] for row in by_point), *by_angles, *to_point[3:]]
    _, to_rotation = jax.vjp(lambda r: photo_vector(r, ray.image.centre, ray.point), ray.image.rotation)
    (p00,), (p10, p11), (p20, p21, p22) = of_image[:3]
    return RayCurvature((p00, p10, p20, p11, p21, p22), mixed, of_image, to_rotation((f1, f2, f3))[0])


def _by_camera(equation: Any, at: tuple[Scalar, ...], weights: tuple[Scalar, ...]) -> tuple[list[Scalar], Lower]:
    """First and second derivatives of F with respect to photo vector and estimated interior elements."""
    constant = tuple(w * w * v for w, v in zip(weights, equation(at[:3], at[3:]), strict=True))

    def gradient(*at: Scalar) -> list[Scalar]:
        by_vector, by_elements = jax.vjp(equation, at[:3], at[3:])[1](constant)
        return [*by_vector, *by_elements]

    def along(k: int) -> list[Scalar]:
        return jax.jvp(lambda x: gradient(*at[:k], x, *at[k + 1 :]), (at[k],), (jnp.ones_like(at[k]),))[1]

    return gradient(*at), [along(k)[: k + 1] for k in range(len(at))]


def summed(lower: Lower) -> Float[Array, "slot number"]:
    """Sums of arrays over the columns."""
    return jnp.concatenate([jnp.sum(x, 1, keepdims=True) for row in lower for x in row], 1)
