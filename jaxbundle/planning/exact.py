"""Image coordinates with zero residuals of the image equation, for any camera model."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.residuals import Observations, observations_of
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.projection import projection


def exact_coordinates(block: Block) -> tuple[Float[np.ndarray, "ray 2"], Float[np.ndarray, "ray 2"]]:
    """Image coordinates with zero residuals of all rays, and the remaining residuals.

    By Newton's method from the principal point, so any camera model can be used; one step is exact for models that do
    not correct the measurement.
    """
    coordinates, left = _exact(unknowns_of(block), observations_of(block))
    return np.asarray(coordinates.T), np.asarray(left.T)


def traced_coordinates(block: Block) -> Float[Array, "ray 2"]:
    """The exact image coordinates as a function of the block, for jit, grad and vmap."""
    return _exact(unknowns_of(block), observations_of(block))[0].T


@eqx.filter_jit
def _exact(unknowns: Unknowns, observations: Observations) -> tuple[Float[Array, "2 ray"], Float[Array, "2 ray"]]:
    image, point = observations.ray_image, observations.ray_point
    interior = tuple(unknowns.interior[:, observations.image_camera[image]])
    vector = photo_vector(
        tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image]), tuple(unknowns.points[:, point])
    )
    measured = projection(observations.model, interior, vector)
    return jnp.stack(measured), jnp.stack(observations.model.residual(interior, vector, measured))
