"""Values on the host: values known before tracing are prepared by numpy, without compilation.

JAX compiles a program for each shape of its operations, even to convert an array. Therefore arrays are arranged on the
host, and `on_host_or_traced` writes such a function once for numbers and for tracers. A compiled function
(`compilation.Compiled`) takes numpy arrays as they are.
"""

import dataclasses
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental import multihost_utils

Tree = TypeVar("Tree")
NUMBERS = (np.ndarray, np.generic, bool, int, float)


def is_concrete(tree: Any) -> bool:
    """Whether all leaves are numbers, not tracers of jit, grad or vmap."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def constant(tree: Any) -> Any:
    """The values without derivatives: numbers, unless they are traced by jit or vmap."""
    return tree if is_concrete(tree) else jax.lax.stop_gradient(tree)


def on_host(tree: Any) -> Any:
    """Converts concrete JAX arrays to numpy; tracers and other objects are unchanged.

    Arrays on devices of several processes are gathered: all processes must call this function.
    """
    return jax.tree.map(_on_host, tree)


def _on_host(value: Any) -> Any:
    if isinstance(value, Tracer) or not isinstance(value, jax.Array):
        return value
    if not (value.is_fully_addressable or value.is_fully_replicated):
        return np.asarray(multihost_utils.process_allgather(value, tiled=True))
    return np.asarray(value)


def on_device(tree: Any, kind: Any = NUMBERS) -> Any:
    """Makes JAX arrays of numbers and numpy arrays, all at once; tracers and other objects are unchanged.

    `kind`: the types that are converted.
    """
    leaves, structure = jax.tree.flatten(tree)
    moves = [isinstance(x, kind) for x in leaves]
    put = iter(jax.device_put([np.asarray(x) for x, move in zip(leaves, moves, strict=True) if move]))
    return jax.tree.unflatten(structure, [next(put) if move else x for x, move in zip(leaves, moves, strict=True)])


def on_host_or_traced(function: Callable[..., Any]) -> Callable[..., Any]:
    """Calls a function of (xp, *values): with numpy and arrays of the host, or with jax.numpy if a value is traced.

    It returns JAX arrays. For few operations on whole arrays, not inside compiled programs.
    """

    @wraps(function)
    def called(*values: Any) -> Any:
        values = on_host(values)
        return on_device(function(array_module(values), *values))

    return called


def tree_with(where: Callable[[Tree], Any], tree: Tree, new: Any) -> Tree:
    """The tree with new arrays, of the host or of JAX, at the places that `where` selects."""
    return eqx.tree_at(where, tree, on_device(new))


@on_host_or_traced
def product(_xp: Any, a: Any, b: Any) -> Any:
    """The product of two arrays, element by element."""
    return a * b


@on_host_or_traced
def selected(_xp: Any, tree: Any, which: np.ndarray) -> Any:
    """Selected members of all arrays of a tree; `which`: their indices, or a mask."""
    return jax.tree.map(lambda x: x[which], tree)


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
