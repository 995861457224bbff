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


def is_concrete(tree: Any) -> bool:
    """Whether all leaves are numbers, not tracers of jit, grad or vmap."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def constant(tree: Any) -> Any:
    """The values without derivatives: numbers, unless they are traced by jit or vmap."""
    return tree if is_concrete(tree) else jax.lax.stop_gradient(tree)


def on_host(tree: Any) -> Any:
    """Converts concrete JAX arrays to numpy; tracers are unchanged.

    Arrays on devices of several processes are gathered: all processes must call this function.
    """
    return jax.tree.map(_on_host, tree)


def _on_host(value: Any) -> Any:
    if isinstance(value, Tracer):
        return value
    if isinstance(value, jax.Array) and not (value.is_fully_addressable or value.is_fully_replicated):
        return np.asarray(multihost_utils.process_allgather(value, tiled=True))
    return np.asarray(value)


def on_device(tree: Any) -> Any:
    """Makes JAX arrays of numbers and numpy arrays, all at once; tracers are unchanged."""
    leaves, structure = jax.tree.flatten(tree)
    put = iter(jax.device_put([np.asarray(x) for x in leaves if not isinstance(x, jax.Array)]))
    return jax.tree.unflatten(structure, [x if isinstance(x, jax.Array) else next(put) for x in leaves])


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
