"""Values on the host: what is known before tracing is prepared by numpy, which compiles nothing."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer


def is_concrete(tree: Any) -> bool:
    """Whether all leaves are numbers, not tracers of a jit, grad or vmap."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def on_host(value: Any) -> Any:
    """A numpy array in place of a concrete JAX array; a tracer stays what it is."""
    return value if isinstance(value, Tracer) else np.asarray(value)
