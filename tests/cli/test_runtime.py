"""JAX as the command line sets it up: double precision, one device per core, a cache of compiled programs."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_runtime_is_in_double_precision_on_all_cores_and_keeps_programs(tmp_path):
    """In a process of its own, as these are settings of the whole process."""
    script = (
        "from jaxbundle.cli import runtime; runtime.start(); import jax; import jax.numpy as jnp;"
        "print(jnp.sin(jnp.ones(3)).dtype, jax.local_device_count() == min(runtime.cores(), 8))"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)}
    environment.pop("JAX_ENABLE_X64", None)
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "float64 True\n"
    assert list((tmp_path / "jaxbundle").iterdir())
