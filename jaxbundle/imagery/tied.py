"""Matching all images of a point at once, constrained by the image equation (Gruen, Baltsavias 1988).

The surface around the point is a plane. In the system of the photograph of the template, with its rays (a, b, -1),

    1 / Z(a, b) = w0 + w1 (a - a0) + w2 (b - b0),    X = X0 + R (a, b, -1) Z        one object point for each pixel
    v_j = r0_j + r1_j g_j(x_j(X), y_j(X)) - f         x_j, y_j by collinearity and the camera model of image j

Three unknowns for all images: the inverse distance w0 of the point along the ray of the template and the slopes w1, w2,
which are its surface normal. The radiometric parameters of each image are eliminated: its rows are projected onto the
complement of (1, g_j). The orientations are fixed, so the result is an object point, not rays.

The noise of the template is common to all images; the standard deviations neglect that.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Real

from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.direction import direction
from jaxbundle.camera.model import CameraModel
from jaxbundle.camera.projection import projection
from jaxbundle.imagery import spline
from jaxbundle.imagery.match_types import MIN_CORRELATION, Refusal
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax

MAX_ITERATIONS = 20
SETTLED = 1e-6  # last step relative to the inverse distance; at a base of half the distance, 0.001 px of 3000 px
MAX_CHANGE = 0.1  # maximum relative change of the inverse distance in one step
PLANE = 3  # number of unknowns


class OrientedWindow(NamedTuple):
    """Windows of oriented images: fields with a leading axis for several images.

    Example:
        >>> jb.imagery.OrientedWindow._fields
        ('grey', 'corner', 'interior', 'rotation', 'centre')
    """

    grey: Float[Array, "*image row column"]
    corner: Float[Array, "*image 2"]
    """Coordinates x, y of the window's corner in the image, px."""
    interior: Float[Array, "*image element"]
    rotation: Float[Array, "*image 9"]
    """Rotation object_from_image, rows a, b, c."""
    centre: Float[Array, "*image 3"]


class TiedMatch(NamedTuple):
    """An object point and its surface from the grey values of all its images.

    Example:
        >>> jb.imagery.TiedMatch._fields[:3]
        ('object_point', 'covariance', 'normal')
    """

    object_point: Float[Array, "3"]
    covariance: Float[Array, "3 3"]
    """Covariance of the object point, which lies on the ray of the template: rank 1."""
    normal: Float[Array, "3"]
    """Unit normal of the surface, towards the template's camera, object system."""
    positions: Float[Array, "image 2"]
    """Image coordinates of the object point in the searched images."""
    correlation: Float[Array, " image"]
    sigma0: Float[Array, ""]
    """Standard deviation of the residuals, in grey values."""
    iterations: Int[Array, ""]
    status: Int[Array, ""]
    """A `Refusal` as a number."""


def match_tied(
    model: CameraModel,
    template: OrientedWindow,
    searched: OrientedWindow,
    point: Real[ArrayLike, "2"] | Nested,
    distance: Real[ArrayLike, ""] | Nested,
) -> TiedMatch:
    """Computes object point and surface normal of a point of the template from all other images at once.

    It works with jit and vmap.

    Args:
        model: camera model of all images.
        template: the window around the point, without a leading axis.
        searched: windows of the other images around its predicted positions.
        point: image coordinates of the point in the template's image.
        distance: approximate Z of the point: along the axis of the template's camera, object unit.

    Returns: the object point with its covariance, the normal, and the reason of a refused match.

    Example:
        >>> found = match_tied(model, template, searched, (1040.5, 880.5), 62.0)  # doctest: +SKIP
        >>> found.object_point, found.normal  # doctest: +SKIP
    """
    prepare_jax()
    arrays = jax.tree.map(lambda x: jnp.asarray(x, float), (template, searched, point, distance))
    return _tied(model, *arrays, optimised=False)


@Compiled
def _tied(model: CameraModel, template: OrientedWindow, searched: OrientedWindow, point: Array, z: Array) -> TiedMatch:
    rows, columns = template.grey.shape
    x = template.corner[0] + jnp.tile(jnp.arange(columns, dtype=float) + 0.5, rows)
    y = template.corner[1] + jnp.repeat(jnp.arange(rows, dtype=float) + 0.5, columns)
    a, b = _plane(model, template.interior, x, y)
    a0, b0 = _plane(model, template.interior, point[:1], point[1:])
    surfaces = jax.vmap(spline.coefficients)(searched.grey)
    f = template.grey.ravel()

    def places(w: Array) -> Array:
        return jax.vmap(lambda image: _seen(model, template, image, _on_plane(w, a, b, (a0, b0))))(searched)

    def rows_of(w: Array) -> tuple[Array, Array, Array]:
        xy, slopes = places(w), jax.jacfwd(places)(w)  # (image, 2, pixel), (image, 2, pixel, 3)
        g, gx, gy = jax.vmap(_with_gradient)(surfaces, xy)
        one = jnp.ones_like(g)
        gc = g - jnp.mean(g, 1, keepdims=True)
        r1 = jnp.sum(gc * f[None], 1) / jnp.maximum(jnp.sum(gc * gc, 1), 1e-12)
        r0 = jnp.mean(f) - r1 * jnp.mean(g, 1)
        v = r0[:, None] + r1[:, None] * g - f[None]
        a_rows = r1[:, None, None] * (gx[..., None] * slopes[:, 0] + gy[..., None] * slopes[:, 1])
        a_rows = a_rows - jnp.mean(a_rows, 1, keepdims=True) * one[..., None]
        along = jnp.einsum("jn,jnk->jk", gc, a_rows) / jnp.maximum(jnp.sum(gc * gc, 1), 1e-12)[:, None]
        return a_rows - gc[..., None] * along[:, None], v, g

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        w, _, k = state
        rows, v, _ = rows_of(w)
        d = -jnp.linalg.solve(jnp.einsum("jna,jnb->ab", rows, rows), jnp.einsum("jna,jn->a", rows, v))
        size = jnp.abs(d[0]) / jnp.abs(w[0])
        d = d * jnp.minimum(1.0, MAX_CHANGE / jnp.maximum(size, 1e-30))
        return w + d, size, k + 1

    start = jnp.stack([1 / z, jnp.zeros(()), jnp.zeros(())]), jnp.asarray(jnp.inf), jnp.asarray(0)
    w, size, k = lax.while_loop(lambda s: (s[1] > SETTLED) & (s[2] < MAX_ITERATIONS), step, start)
    rows, v, g = rows_of(w)
    normals = jnp.einsum("jna,jnb->ab", rows, rows)
    variance = jnp.sum(v * v) / (v.size - PLANE - 2 * v.shape[0])
    cofactor = jnp.linalg.solve(normals, jnp.eye(PLANE)[0])[0]
    along = _turned(template.rotation, jnp.stack([a0[0], b0[0], -jnp.ones(())]))
    sigma = jnp.sqrt(variance * cofactor) / w[0] ** 2
    across = jnp.stack([w[1], w[2], -(w[0] - w[1] * a0[0] - w[2] * b0[0])])
    normal = _turned(template.rotation, -across / jnp.linalg.norm(across))
    own = jnp.stack([a0, b0, -jnp.ones(1)]) / w[0]
    object_point = template.centre + along / w[0]
    correlation = jax.vmap(lambda g: jnp.corrcoef(f, g)[0, 1])(g)
    inside = jax.vmap(_inside)(places(w), searched)
    positions = jax.vmap(lambda image: _seen(model, template, image, own)[:, 0])(searched)
    return TiedMatch(
        object_point,
        sigma**2 * jnp.outer(along, along),
        jnp.where(jnp.sum(normal * along) > 0, -normal, normal),
        positions + searched.corner,
        correlation,
        jnp.sqrt(variance),
        k,
        _status(w, size, inside, correlation),
    )


def _status(w: Array, size: Array, inside: Bool[Array, " image"], correlation: Array) -> Array:
    """The first applicable reason of refusal."""
    status = jnp.where(jnp.min(correlation) >= MIN_CORRELATION, int(Refusal.MATCHED), int(Refusal.LOW_CORRELATION))
    status = jnp.where(jnp.all(inside), status, int(Refusal.OUTSIDE))
    status = jnp.where(size <= SETTLED, status, int(Refusal.NOT_CONVERGED))
    return jnp.where(jnp.isfinite(w).all(), status, int(Refusal.NO_TEXTURE))


def _plane(model: CameraModel, interior: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Components a and b of photo vectors (a, b, -1)."""
    dx, dy, dz = direction(model, tuple(interior), (x, y))
    return -dx / dz, -dy / dz


def _on_plane(w: Array, a: Array, b: Array, at: tuple[Array, Array]) -> Array:
    """Photo vectors (a, b, -1) Z of the pixels, on the plane."""
    z = 1 / (w[0] + w[1] * (a - at[0]) + w[2] * (b - at[1]))
    return jnp.stack([a * z, b * z, -z])


def _turned(rotation: Array, vector: Array) -> Array:
    return rotation.reshape(3, 3) @ vector


def _seen(model: CameraModel, template: OrientedWindow, image: OrientedWindow, points: Array) -> Array:
    """Positions in the window of an image for photo vectors of the template's camera (3, pixel)."""
    points = template.centre[:, None] + _turned(template.rotation, points)
    vector = photo_vector(tuple(image.rotation), tuple(image.centre), tuple(points))
    x, y = projection(model, tuple(image.interior), vector)
    return jnp.stack([x - image.corner[0], y - image.corner[1]])


def _with_gradient(surface: Array, xy: Array) -> tuple[Array, Array, Array]:
    """Grey values with their exact derivatives."""
    one = jnp.ones_like(xy[0])
    g, gx = jax.jvp(lambda x: spline.value(surface, x, xy[1]), (xy[0],), (one,))
    return g, gx, jax.jvp(lambda y: spline.value(surface, xy[0], y), (xy[1],), (one,))[1]


def _inside(xy: Array, image: OrientedWindow) -> Array:
    rows, columns = image.grey.shape
    low, high = jnp.min(xy, 1), jnp.max(xy, 1)
    return (low >= 0.5).all() & (high[0] <= columns - 0.5) & (high[1] <= rows - 0.5)
