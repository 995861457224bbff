"""Vectors of the reduced equations as corrections of the unknowns, and sums over rays as such vectors."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.unknowns import Correction, Unknowns
from jaxbundle.normals.chunks import image_table
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.problem import Linearised, OrderedUnknowns, Problem, ReducedVector


def correction_of(x: ReducedVector, p: Problem, unknowns: OrderedUnknowns) -> Correction:
    """A step of images and border as a correction of them."""
    o, layout = p.observations, p.layout
    shared, parameters, points = jnp.split(x.border, [layout.first_parameter, layout.first_point])
    by_camera = x.images[:, EXTERIOR:] if layout.own_cameras else shared.reshape(layout.cameras, layout.shared)
    interior = jnp.zeros_like(unknowns.images.interior)
    if o.columns:
        interior = interior.at[np.array(o.columns)].set(by_camera.T)
    return Correction(x.images[:, :EXTERIOR].T, interior, parameters, points.reshape(-1, 3).T)


def values_along(x: ReducedVector, linear: Linearised) -> Float[Array, "image number"]:
    """Change of the values of the images by a step."""
    correction = correction_of(x, linear.problem, linear.unknowns)
    turned = jnp.sum(linear.d_rotation * correction.exterior[None, 3:], 1)
    moved = Unknowns(turned, correction.exterior[:3], correction.interior, correction.parameters, correction.points)
    return image_table(moved, None, linear.problem.observations)


def reduced_rows(rows: Float[Array, "image number"], linear: Linearised) -> ReducedVector:
    """Converts sums over rays from the values of the images to the unknowns of the reduced equations."""
    o, layout = linear.problem.observations, linear.problem.layout
    angles = jnp.einsum("eai,ie->ia", linear.d_rotation, rows[:, :9])
    interior = rows[:, 12:][:, np.array(o.columns, int)]
    border = jnp.zeros(layout.border)
    if layout.shared:
        border = border.at[layout.camera_rows(o.image_camera)].add(interior)
    parts = [rows[:, 9:12], angles] + ([interior] if layout.own_cameras else [])
    return ReducedVector(jnp.concatenate(parts, 1), border)
