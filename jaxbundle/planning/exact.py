"""Image coordinates at which the package's own image equation leaves no residual, for any camera model."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.residuals import Observations, observations_of, ray_residuals
from jaxbundle.block.unknowns import Unknowns, unknowns_of

NEWTON_STEPS = 10  # a strong distortion needs about six


def exact_coordinates(block: Block) -> tuple[Float[np.ndarray, "ray 2"], Float[np.ndarray, "ray 2"]]:
    """Image coordinates at which every ray's residual vanishes, and what is left of the residual.

    By Newton's method from the principal point, so that any camera model will do; exact at once for models that do not
    correct the measurement.
    """
    coordinates, left = _exact(unknowns_of(block), observations_of(block))
    return np.asarray(coordinates.T), np.asarray(left.T)


def traced_coordinates(block: Block) -> Float[Array, "ray 2"]:
    """The exact image coordinates as a function of the block, for jit, grad and vmap."""
    return _exact(unknowns_of(block), observations_of(block))[0].T


@eqx.filter_jit
def _exact(unknowns: Unknowns, observations: Observations) -> tuple[Float[Array, "2 ray"], Float[Array, "2 ray"]]:
    elements = observations.model.elements
    start = jnp.zeros_like(observations.coordinates)
    if "x0" in elements:
        camera = observations.image_camera[observations.ray_image]
        start = jnp.stack([unknowns.interior[elements.index(name), camera] for name in ("x0", "y0")])
    one, zero = jnp.ones_like(start[0]), jnp.zeros_like(start[0])

    def residual(measured: Array) -> Array:
        return ray_residuals(unknowns, eqx.tree_at(lambda o: o.coordinates, observations, measured))

    def step(_: Int[Array, ""], measured: Array) -> Array:
        v, (xx, yx) = jax.jvp(residual, (measured,), (jnp.stack([one, zero]),))
        _, (xy, yy) = jax.jvp(residual, (measured,), (jnp.stack([zero, one]),))
        determinant = xx * yy - xy * yx
        return measured - jnp.stack([yy * v[0] - xy * v[1], xx * v[1] - yx * v[0]]) / determinant

    measured = jax.lax.fori_loop(0, NEWTON_STEPS, step, start)
    return measured, residual(measured)
