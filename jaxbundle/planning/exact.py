"""Image coordinates with zero residuals of the image equation, for any camera model."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.camera.projection import projection
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device
from jaxbundle.numerics.shapes import MIN_POINTS, padded


class _Rays(NamedTuple):
    """Indices of the images, cameras and points of the rays."""

    image: Int[Array, " ray"]
    camera: Int[Array, " ray"]
    point: Int[Array, " ray"]


def exact_coordinates(block: Block) -> tuple[Float[np.ndarray, "ray 2"], Float[np.ndarray, "ray 2"]]:
    """Image coordinates with zero residuals of all rays, and the remaining residuals.

    By Newton's method from the principal point, so any camera model can be used; one step is exact for models that do
    not correct the measurement.
    """
    u, count = unknowns_of(block), len(block.structure.ray_image)
    places = padded(u.rotation), padded(u.centre), padded(u.interior, 1)
    unknowns = Unknowns(*on_device((*places, np.zeros(0), padded(u.points, MIN_POINTS))))
    rays = _Rays(*on_device(tuple(padded(index, MIN_POINTS) for index in _indices(block))))
    coordinates, left = _exact(block.structure.model, unknowns, rays, optimised=False)
    return np.asarray(coordinates).T[:count], np.asarray(left).T[:count]


def traced_coordinates(block: Block) -> Float[Array, "ray 2"]:
    """The exact image coordinates as a function of the block, for jit, grad and vmap."""
    rays = _Rays(*on_device(_indices(block)))
    return _exact(block.structure.model, unknowns_of(block), rays, optimised=False)[0].T


def _indices(block: Block) -> tuple[Int[np.ndarray, " ray"], ...]:
    s = block.structure
    return tuple(index.astype(np.int32) for index in (s.ray_image, s.image_camera[s.ray_image], s.ray_point))


@Compiled
def _exact(model: CameraModel, unknowns: Unknowns, rays: _Rays) -> tuple[Float[Array, "2 ray"], Float[Array, "2 ray"]]:
    image, camera, point = rays
    interior = tuple(unknowns.interior[:, camera])
    vector = photo_vector(
        tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image]), tuple(unknowns.points[:, point])
    )
    measured = projection(model, interior, vector)
    return jnp.stack(measured), jnp.stack(model.residual(interior, vector, measured))
