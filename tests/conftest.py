import gc
import os
from pathlib import Path

# before the workers import numpy: on busy cores, threads of BLAS that wait take ten times the time of the computation
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax  # noqa: E402
import pytest
from cases.typechecker import unchecked  # before the package
from hypothesis import settings

from jaxbundle.numerics import programs
from jaxbundle.numerics.compilation import Compiled

# the suite is compilation: all programs are made quickly, as those of small blocks always are
QUICKLY = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {QUICKLY}"
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 4)
# the package leaves no promotion of types or ranks to JAX
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")

gc.set_threshold(100_000, 20, 100)  # tracing makes many objects and few cycles
MAPS, MAX_MAPS = Path("/proc/self/maps"), 20_000
MEMORY, MAX_PAGES = Path("/proc/self/statm"), 3_000_000_000 // os.sysconf("SC_PAGE_SIZE")
TESTS = Path(__file__).parent
SHARED_DATA = TESTS.parents[1] / "shared" / "data"


def pytest_configure(config: pytest.Config) -> None:
    """Compiled programs are kept beside pytest's own cache: the workers share them, and the next run has them."""
    if hasattr(config, "cache"):
        jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("compiled")))
        programs.keep_in(Path(config.cache.mkdir("programs")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@pytest.fixture(scope="module", autouse=True)
def forgotten_programs():
    """Programs hold memory maps, of which a process may have some 65 thousand (vm.max_map_count).

    They are forgotten only where these become many, or the process large (3 GB): what the next module needs again is
    not compiled again.
    """
    yield
    full = MEMORY.exists() and int(MEMORY.read_bytes().split()[1]) > MAX_PAGES
    if full or not MAPS.exists() or MAPS.read_bytes().count(b"\n") > MAX_MAPS:
        Compiled.forget()
        jax.clear_caches()


@pytest.fixture
def unchecked_types():
    """For tests that pass wrong types on purpose."""
    with unchecked():
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real blocks beside the project; where they are absent the test is skipped, on the build machine it fails."""
    if not SHARED_DATA.is_dir():
        reason = f"the real blocks are not there: {SHARED_DATA}"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    return SHARED_DATA
