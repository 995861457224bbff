"""Similarity transformations in space, and their closed form for two sets of points.

    X = lambda R x + T,        sum w |lambda R x + T - X|^2 = min,        det R = +1

With centroids x_c, X_c and H = sum w (X - X_c)(x - x_c)^T = U D V^T (Umeyama 1991, eqs. 34-43; Horn 1987):

    S = diag(1, 1, det U det V),  R = U S V^T,  lambda = tr(D S) / sum w |x - x_c|^2,  T = X_c - lambda R x_c
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class Similarity(eqx.Module):
    """A similarity transformation X = scale * rotation x + translation.

    Example:
        >>> move = jb.orientation.Similarity(jnp.array(2.0), jnp.eye(3), jnp.array([1.0, 0.0, 0.0]))
        >>> move.scale * move.rotation @ jnp.ones(3) + move.translation
        Array([3., 2., 2.], dtype=float64)
    """

    scale: Float[Array, "*solution"]
    """Ratio of a length in the object system to the length in the model."""
    rotation: Float[Array, "*solution 3 3"]
    """Matrix object_from_model, determinant +1."""
    translation: Float[Array, "*solution 3"]
    """Object coordinates of the origin of the model."""

    def __call__(self, points: Float[Array, "point 3"]) -> Float[Array, "*solution point 3"]:
        """Transforms model points to object coordinates."""
        turned = jnp.einsum("...ij,pj->...pi", self.rotation, jnp.asarray(points))
        return self.scale[..., None, None] * turned + self.translation[..., None, :]


class ClosedForm(NamedTuple):
    """The similarity of two sets of points, and its quality."""

    similarity: Similarity
    singular_values: Float[Array, "3"]
    """Singular values D in decreasing order: two are 0 for points on a line, one for points in a plane."""
    mirrored: Bool[Array, ""]
    """Whether a reflection fits better than any rotation."""


def similarity(
    model: Float[Array, "point 3"], object_points: Float[Array, "point 3"], weights: Float[Array, " point"]
) -> ClosedForm:
    """Computes the similarity in closed form; a weight of 0 excludes a point. It works with jit and vmap."""
    total, used = jnp.sum(weights), (weights > 0)[:, None]
    x, o = jnp.where(used, model, 0.0), jnp.where(used, object_points, 0.0)
    x_centre, o_centre = weights @ x / total, weights @ o / total
    dx, do = jnp.where(used, x - x_centre[None], 0.0), jnp.where(used, o - o_centre[None], 0.0)
    u, d, vt = jnp.linalg.svd((weights[:, None] * do).T @ dx)
    sign = jnp.sign(jnp.linalg.det(u) * jnp.linalg.det(vt))
    s = jnp.array([1.0, 1.0, 0.0]) + sign * jnp.array([0.0, 0.0, 1.0])
    r = (u * s[None]) @ vt
    scale = d @ s / (weights @ jnp.sum(dx * dx, 1))
    return ClosedForm(Similarity(scale, r, o_centre - scale * r @ x_centre), d, sign < 0)
