"""Values on the host: what is known before tracing is prepared by numpy, which compiles nothing.

JAX makes a program for every shape of its operations, even to take over an array: `on_device` does so without one.
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
    """Whether all leaves are numbers, not tracers of a jit, grad or vmap."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def constant(tree: Any) -> Any:
    """The same values without derivatives: numbers, unless they are traced by jit or vmap."""
    return tree if is_concrete(tree) else jax.lax.stop_gradient(tree)


def on_host(value: Any) -> Any:
    """A numpy array in place of a concrete JAX array; a tracer stays what it is.

    What lies on devices of several processes is gathered: there all of them must ask for it.
    """
    if isinstance(value, Tracer):
        return value
    if isinstance(value, jax.Array) and not (value.is_fully_addressable or value.is_fully_replicated):
        return np.asarray(multihost_utils.process_allgather(value, tiled=True))
    return np.asarray(value)


def on_device(value: Any, dtype: Any = None) -> Array:
    """A JAX array of a number, a numpy array or a tracer."""
    if isinstance(value, jax.Array):
        return value if dtype is None else value.astype(dtype)
    return jax.device_put(np.asarray(value, dtype))


def array_module(tree: Any) -> Any:
    """numpy where all leaves are numbers, jax.numpy where they are traced."""
    return np if is_concrete(tree) else jnp


def freeze_arrays(holder: Any) -> None:
    """Makes the numpy arrays among the fields of a dataclass read-only, for use at its construction.

    What is compiled and what is planned for the holder is found again by its identity, so its arrays must not change.
    An array that its caller could still write to is replaced by a copy.
    """
    for field in dataclasses.fields(holder):
        value = getattr(holder, field.name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            value = value.copy()
            value.setflags(write=False)
            object.__setattr__(holder, field.name, value)
