"""Second derivatives of v^T P v / 2 that the normal equations leave out.

    H = N + sum of w^2 v d2v        N = A^T P A; w^2 v is held

Of a ray, with F = sum of w^2 v, a function of photo vector p and interior elements e, and p_X, p_a its derivatives by
the object point and by the angles:

    F_XX = p_X^T F_pp p_X        F_Xa = p_X^T F_pp p_a + F_p p_Xa        F_Xe = p_X^T F_pe
                                 F_aa = p_a^T F_pp p_a + F_p p_aa        F_ae = p_a^T F_pe        F_ee

p contains X - X0 only: what belongs to a projection centre is what belongs to the point, of opposite sign. F_p p_aa
comes from how a rotation matrix bends with its angles, alike for all rays of an image, and is added to their sums.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxbundle.camera.collinearity import Vector, photo_vector
from jaxbundle.camera.model import CameraModel, ImagePoint
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.normals.point_blocks import Symmetric
from jaxbundle.normals.rows import ImageScalars, camera_equation, chained, photo_vector_derivatives
from jaxbundle.numerics.stored import stored

Lower = list[list[Scalar]]  # rows of a lower triangle


class RayCurvature(NamedTuple):
    """Second derivatives of F: by the point, by the unknowns of the image and the point, by those of the image, without
    F_p p_aa. `rotation`: its gradient by the elements of the matrix."""

    point: Symmetric
    mixed: list[Any]
    image: Lower
    rotation: Rotation


def ray_curvature(
    model: CameraModel,
    columns: tuple[int, ...],
    image: ImageScalars,
    point: Vector,
    measured: ImagePoint,
    weights: ImagePoint,
    zero: Int[Array, ""],
) -> RayCurvature:
    """Of one image point; `weights`: square roots, `columns`: estimated interior elements, `zero`: see `stored`."""
    p = photo_vector_derivatives(image, point)
    p = p._replace(value=stored(p.value, zero), turned=stored(p.turned, zero))
    at = *p.value, *(image.interior[column] for column in columns)
    (f1, f2, f3, *_), lower = stored(_by_camera(camera_equation(model, columns, image, measured), at, weights), zero)
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
    _, to_rotation = jax.vjp(lambda r: photo_vector(r, image.centre, point), image.rotation)
    (p00,), (p10, p11), (p20, p21, p22) = of_image[:3]
    return RayCurvature((p00, p10, p20, p11, p21, p22), mixed, of_image, to_rotation((f1, f2, f3))[0])


def _by_camera(equation: Any, at: tuple[Scalar, ...], weights: ImagePoint) -> tuple[list[Scalar], Lower]:
    """First and second derivatives of F by photo vector and estimated interior elements."""
    held = tuple(w * w * v for w, v in zip(weights, equation(at[:3], at[3:]), strict=True))

    def gradient(*at: Scalar) -> list[Scalar]:
        by_vector, by_elements = jax.vjp(equation, at[:3], at[3:])[1](held)
        return [*by_vector, *by_elements]

    def along(k: int) -> list[Scalar]:
        return jax.jvp(lambda x: gradient(*at[:k], x, *at[k + 1 :]), (at[k],), (jnp.ones_like(at[k]),))[1]

    return gradient(*at), [along(k)[: k + 1] for k in range(len(at))]


def summed(lower: Lower) -> Float[Array, "slot number"]:
    """Sums over the columns."""
    return jnp.concatenate([jnp.sum(x, 1, keepdims=True) for row in lower for x in row], 1)
