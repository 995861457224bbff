"""From image to space: the photo vector of a measured point, for any camera model."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.camera.model import CameraModel, Residual
from jaxbundle.geometry.rotation import Scalar

# Newton steps: a correction of the measurement needs one, a strong distortion of the projection about six
NEWTON_STEPS = 10
SETTLED = 1e-13  # share of the principal distance: below this a Newton step is rounding


def direction(
    model: CameraModel, interior: tuple[Scalar, ...], measured: tuple[Float[Array, "..."], Float[Array, "..."]]
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Unit vector along the ray, in the system of the photograph; arguments are arrays of one shape.

    The photo vector (a, b, -1) is the one with zero residual, by Newton's method, so any camera model can be inverted.
    """
    one, zero = jnp.ones_like(measured[0]), jnp.zeros_like(measured[0])

    def residual(a: Array, b: Array) -> Residual:
        return model.residual(interior, (a, b, -one), measured)

    def step(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        a, b, _, k = state
        (vx, vy), (xa, ya) = jax.jvp(residual, (a, b), (one, zero))
        _, (xb, yb) = jax.jvp(residual, (a, b), (zero, one))
        determinant = xa * yb - xb * ya
        da, db = (yb * vx - xb * vy) / determinant, (xa * vy - ya * vx) / determinant
        return a - da, b - db, jnp.any(jnp.maximum(jnp.abs(da), jnp.abs(db)) > SETTLED), k + 1

    start = zero, zero, jnp.array(True), jnp.array(0)
    a, b, *_ = jax.lax.while_loop(lambda state: state[2] & (state[3] < NEWTON_STEPS), step, start)
    length = jnp.sqrt(a * a + b * b + 1)
    return a / length, b / length, -1 / length
