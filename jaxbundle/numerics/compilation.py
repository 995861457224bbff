"""Compilation: small blocks want a program quickly, large ones a quick program."""

from collections.abc import Callable, Hashable
from typing import Any

import equinox as eqx
import jax

from jaxbundle.numerics.host import is_concrete

RAYS_FOR_OPTIMISATION = 20_000  # below, an adjustment takes less time than optimising its program
QUICKLY = {"xla_backend_optimization_level": 0}


class Compiled:
    """A function compiled for the arrays of its arguments; everything else in them is static and must be hashable.

    With `optimised` False the program is compiled in about half the time.
    """

    def __init__(self, function: Callable[..., Any]):
        self.function = function
        self._optimised = jax.jit(self._call, static_argnums=0)
        self._quick = jax.jit(self._call, static_argnums=0, compiler_options=QUICKLY)

    def _call(self, static: tuple[tuple[Hashable, ...], Any], arrays: Any) -> Any:
        leaves, structure = static
        return self.function(*eqx.combine(arrays, jax.tree.unflatten(structure, leaves)))

    def __call__(self, *args: Any, optimised: bool) -> Any:
        """The function's value."""
        if not is_concrete(args):  # inside another program there is nothing to compile here
            return self.function(*args)
        arrays, rest = eqx.partition(args, eqx.is_array)
        leaves, structure = jax.tree.flatten(rest)
        return (self._optimised if optimised else self._quick)((tuple(leaves), structure), arrays)
