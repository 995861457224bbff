"""Values on the host: values known before tracing are prepared by numpy, without compilation.

JAX compiles a program for each shape of its operations, even to convert an array; `on_device` avoids that.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental import multihost_utils
from jaxtyping import Array


def is_concrete(tree: Any) -> bool:
    """Whether all leaves are numbers, not tracers of jit, grad or vmap."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def constant(tree: Any) -> Any:
    """The values without derivatives: numbers, unless they are traced by jit or vmap."""
    return tree if is_concrete(tree) else jax.lax.stop_gradient(tree)


def on_host(value: Any) -> Any:
    """Converts a concrete JAX array to numpy; a tracer is unchanged.

    Arrays on devices of several processes are gathered: all processes must call this function.
    """
    if isinstance(value, Tracer):
        return value
    if isinstance(value, jax.Array) and not (value.is_fully_addressable or value.is_fully_replicated):
        return np.asarray(multihost_utils.process_allgather(value, tiled=True))
    return np.asarray(value)


def on_device(value: Any, dtype: Any = None) -> Array:
    """Makes a JAX array of a number, a numpy array or a tracer."""
    if isinstance(value, jax.Array):
        return value if dtype is None else value.astype(dtype)
    return jax.device_put(np.asarray(value, dtype))


def array_module(tree: Any) -> Any:
    """Returns numpy if all leaves are numbers, jax.numpy if they are traced."""
    return np if is_concrete(tree) else jnp


def freeze_arrays(holder: Any) -> None:
    """Makes the numpy arrays among the fields of a dataclass read-only, for use at its construction.

    Compiled programs and plans are looked up by the identity of the dataclass, so its arrays must not change. An array
    that the caller could still modify is replaced by a copy.
    """
    for field in dataclasses.fields(holder):
        value = getattr(holder, field.name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            value = value.copy()
            value.setflags(write=False)
            object.__setattr__(holder, field.name, value)
