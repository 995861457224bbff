"""Methods whose work is done in a higher room: a type offers them by name, and they are loaded when they are called.

Imports go down only. A method such as `Block.from_tables` or `Adjustment.to_frames` is where a user looks for it, and
reading tables or making reports lies above blocks and adjustments. This table is the one place that names what lies
above; a test holds it against the modules.
"""

import importlib
from typing import Any

HOMES = {
    "block_from_tables": "jaxbundle.io.block_from_tables",
    "frames_of": "jaxbundle.report.frames",
}


def offered(name: str) -> Any:
    """The function of that name from its home."""
    return getattr(importlib.import_module(HOMES[name]), name)
