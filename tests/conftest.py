import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)

SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real blocks beside the project; where they are absent the test is skipped, on the build machine it fails."""
    if not SHARED_DATA.is_dir():
        reason = f"the real blocks are not there: {SHARED_DATA}"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    return SHARED_DATA
