"""Ahead-of-time compilation with a persistent cache; small blocks use less optimisation for fast compilation."""

from collections.abc import Callable, Hashable
from typing import Any, ClassVar
from uuid import uuid4
from weakref import WeakSet

import equinox as eqx
import jax
import numpy as np
from jax import Array

from jaxbundle.numerics import programs
from jaxbundle.numerics.devices import meet
from jaxbundle.numerics.host import is_concrete, on_device

RAYS_FOR_OPTIMISATION = 10_000  # below this, an adjustment takes less time than optimising its program
QUICKLY = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


class Compiled:
    """A function compiled for the arrays of its arguments; all other arguments are static and must be hashable.

    With `optimised` False the program is compiled in about half the time. Programs are cached on disk for later
    processes if a folder is set (`programs.keep_in`).
    """

    _all: ClassVar["WeakSet[Compiled]"] = WeakSet()

    def __init__(self, function: Callable[..., Any]):
        self.function = function
        self._programs: dict[Hashable, programs.Program] = {}
        self._traced: dict[Hashable, Callable[..., Any]] = {}
        Compiled._all.add(self)

    @classmethod
    def forget(cls) -> None:
        """Frees all programs of this process; each uses memory maps, whose number is limited by the system."""
        for compiled in cls._all:
            compiled._programs.clear()
            compiled._traced.clear()

    def __call__(self, *args: Any, optimised: bool) -> Any:
        """Calls the compiled function; it takes numpy arrays too."""
        leaves, structure = jax.tree.flatten(args)
        leaves = on_device(leaves, np.ndarray)
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        static = tuple(None if eqx.is_array(leaf) else leaf for leaf in leaves)
        if not is_concrete(args):
            return self._inside(structure, static)(*arrays)
        placed = tuple((a.shape, a.dtype, a.weak_type, a.sharding if a.committed else None) for a in arrays)
        key = structure, static, placed, optimised
        if key not in self._programs:
            self._programs[key] = self._program(structure, static, arrays, {} if optimised else QUICKLY)
            if not all(array.is_fully_addressable for array in arrays):
                meet()
        return self._programs[key](arrays)

    def _inside(self, structure: Any, static: tuple) -> Callable[..., Any]:
        """The function for traced arguments; a program inside another one has no separate options."""
        key = structure, static
        if key not in self._traced:

            def on_arrays(*arrays: Array) -> Any:
                given = iter(arrays)
                leaves = [next(given) if leaf is None else leaf for leaf in static]
                return self.function(*jax.tree.unflatten(structure, leaves))

            self._traced[key] = jax.jit(on_arrays)
        return self._traced[key]

    def _program(self, structure: Any, static: tuple, arrays: list[Array], options: dict) -> programs.Program:
        """The program from the cache folder, or a new one."""
        folder, file = programs.folder(), None
        if folder is not None:
            described = jax.tree.unflatten(structure, range(len(static)))
            name = programs.program_name(self.function, (described, static), arrays, options)
            file = folder / name if name else None
        program = programs.load(file, arrays) if file else None
        if program is not None:
            return program
        value = []

        def on_leaves(*arrays: Array) -> list[Array]:
            given = iter(arrays)
            args = jax.tree.unflatten(structure, [next(given) if leaf is None else leaf for leaf in static])
            out, out_structure = jax.tree.flatten(self.function(*args))
            value.append(jax.tree.unflatten(out_structure, range(len(out))))
            return out

        if file:
            # a program from JAX's cache cannot be written again; a new name avoids that cache
            on_leaves.__name__ = f"{self.function.__name__}_{uuid4().hex}"
        compiled = jax.jit(on_leaves, compiler_options=options).lower(*arrays).compile()
        if file:
            programs.keep(file, compiled, arrays, value[0])
        return programs.Program(compiled, value[0])
