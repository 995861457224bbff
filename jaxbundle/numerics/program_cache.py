"""The cache of compiled programs: active in all processes that compute, unless the user switches it off.

JAX compiles a program for each new size of a block, which takes seconds to a minute. Compiled programs are stored in
the user's cache folder, by JAX and by `programs`, for later processes. As a program from the cache is executed, the
folder is trusted only if it belongs to the user and nobody else may write to it (`private_folder`).

The environment variable JAXBUNDLE_CACHE is "off", or an absolute path of the folder. Settings of JAX have priority:
a cache folder (`jax_compilation_cache_dir`, JAX_COMPILATION_CACHE_DIR), or none (`jax_enable_compilation_cache`).
"""

import hashlib
import os
import platform
from functools import cache
from pathlib import Path

import jax

from jaxbundle.numerics import programs
from jaxbundle.numerics.float64 import require_float64
from jaxbundle.numerics.private_folder import private_folder, trim

SWITCH, OFF = "JAXBUNDLE_CACHE", "off"
# bytes of compiled programs: each new shape of a block and each new version adds 1 to 10 MB, so this is enough for #
# some hundred programs; a deleted program is compiled again
MAX_BYTES = 500_000_000
MIN_SECONDS = 0.05  # minimum time of a compilation that JAX stores: reading a file takes some milliseconds


def prepare_jax() -> None:
    """Requires double precision and switches the cache on: each public function that computes begins with this.

    Raises: ValueError unless JAX computes in double precision.
    """
    require_float64()
    keep_programs()


@cache  # once per process: later settings of the user are not changed
def keep_programs() -> None:
    """Stores the compiled programs of this process in the user's cache folder, unless another folder is set."""
    jax_keeps = programs.setting("jax_compilation_cache_dir") is not None
    folder = cache_folder() if programs.setting("jax_enable_compilation_cache") else None
    if folder is None or (jax_keeps and programs.chosen_folder()):
        return
    private = private_folder(folder)
    if private is None:
        return
    trim(private, MAX_BYTES)
    if not programs.chosen_folder():
        programs.keep_in(private / "programs")
    if not jax_keeps:
        # programs depend on the processor, and many machines may share a home folder
        machine = hashlib.sha256(platform.node().encode()).hexdigest()[:12]
        jax.config.update("jax_compilation_cache_dir", str(private / "jax" / machine))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_SECONDS)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path | None:
    """The cache folder: JAXBUNDLE_CACHE, or the user's cache folder by the XDG base directory specification.

    A path that is not absolute is ignored. None where the cache is switched off, and for a user without a home.
    """
    own = os.environ.get(SWITCH, "")
    if own.lower() == OFF:
        return None
    if Path(own).is_absolute():
        return Path(own)
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        folder = given if given.is_absolute() else Path.home() / ".cache"
    except RuntimeError:
        return None
    return folder / "jaxbundle" if folder.is_absolute() else None
