"""Vectors of the kept unknowns, images and border: which are free, and what they are as corrections of the unknowns."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.unknowns import Correction, Unknowns
from jaxbundle.normals.arrange import Arranged, Problem


class KeptVector(NamedTuple):
    """A vector of kept unknowns."""

    images: Float[Array, "image d"]
    border: Float[Array, " border"]

    def dot(self, other: "KeptVector") -> Float[Array, ""]:
        """Scalar product."""
        return jnp.sum(self.images * other.images) + jnp.sum(self.border * other.border)


def kept_free(p: Problem) -> KeptVector:
    """Which kept unknowns are free."""
    o, shape = p.observations, p.shape
    images = o.exterior_free.T if shape.image == 6 else jnp.concatenate([o.exterior_free, o.interior_free]).T
    interior = o.interior_free.T.ravel() if shape.first_parameter else jnp.zeros(0, bool)
    points = o.point_free[:, o.point_free.shape[1] - shape.kept :].T.ravel()
    return KeptVector(images, jnp.concatenate([interior, o.parameter_free, points]))


def correction_of(
    images: Float[Array, "image d"], border: Float[Array, " border"], p: Problem, unknowns: Arranged
) -> Correction:
    """A step of the kept unknowns as a correction of them."""
    o, (d, q, cameras, *_) = p.observations, p.shape
    by_camera = images[:, 6:] if d > 6 else border[: q * cameras].reshape(cameras, q)
    interior = jnp.zeros_like(unknowns.images.interior)
    if o.columns:
        interior = interior.at[np.array(o.columns)].set(by_camera.T)
    parameters, points = jnp.split(border[q * cameras :], [p.shape.parameters])
    return Correction(images[:, :6].T, interior, parameters, points.reshape(-1, 3).T)


def direction_of(correction: Correction, turns: Float[Array, "9 3 image"]) -> Unknowns:
    """The correction as a direction in the space of the unknowns."""
    turned = jnp.sum(turns * correction.exterior[3:], 1)
    return Unknowns(turned, correction.exterior[:3], correction.interior, correction.parameters, correction.points)


def kept_rows(rows: Float[Array, "image number"], turns: Float[Array, "9 3 image"], p: Problem) -> KeptVector:
    """Sums over rays, by the numbers of `image_values`, as sums by the kept unknowns."""
    o, (d, q, *_) = p.observations, p.shape
    angles = jnp.einsum("eai,ie->ia", turns, rows[:, :9])
    interior = rows[:, 12:][:, np.array(o.columns, int)]
    border = jnp.zeros(p.shape.border)
    if d == 6 and q:
        border = border.at[q * o.image_camera[:, None] + jnp.arange(q)].add(interior)
    parts = [rows[:, 9:12], angles] + ([interior] if d > 6 else [])
    return KeptVector(jnp.concatenate(parts, 1), border)
