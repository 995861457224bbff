"""JAX as the command line needs it: double precision, a device a core, and compiled programs kept for the next call."""

import os
from pathlib import Path

import jax

from jaxbundle.numerics import programs

MOST_DEVICES = 8  # each holds the reduced normal equations in full


def start(processes: int = 1) -> None:
    """To be called before anything is computed, in each of the processes that share the cores."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", max(1, min(_cores() // processes, MOST_DEVICES)))
    jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
    programs.keep_in(cache_folder() / "programs")
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path:
    """The user's cache folder by the XDG base directory specification, which ignores a path that is not absolute."""
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "jaxbundle"


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
