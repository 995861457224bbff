"""JAX as the command line needs it: double precision, and compiled programs kept from one call to the next."""

import os
from pathlib import Path

import jax


def start() -> None:
    """To be called before anything is compiled."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path:
    """The user's cache folder by the XDG base directory specification, which ignores a path that is not absolute."""
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "jaxbundle"
