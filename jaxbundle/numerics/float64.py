"""Checking for double precision: in single precision, rounding destroys the last four digits of an adjustment."""

import jax
import jax.numpy as jnp


def require_float64() -> None:
    """Raises a ValueError with the cure unless JAX computes in double precision."""
    if jax.dtypes.canonicalize_dtype(float) != jnp.float64:
        raise ValueError(
            "jaxbundle computes in double precision, and JAX is set to single; switch it on before the first array is "
            'made: jax.config.update("jax_enable_x64", True), or set JAX_ENABLE_X64=1 in the environment'
        )
