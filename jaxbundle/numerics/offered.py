"""Methods that are implemented in a higher layer: a type has their names, and they are imported when called.

Imports go to lower layers only. Users expect methods such as `Block.from_tables` or `Adjustment.to_frames`, but reading
tables and making reports are in higher layers than blocks and adjustments. This table is the only reference to higher
layers; a test compares it with the modules.
"""

import importlib
from typing import Any

HOMES = {
    "block_from_tables": "jaxbundle.io.block_from_tables",
    "frames_of": "jaxbundle.report.frames",
}


def offered(name: str) -> Any:
    """Imports the function of a name from its module."""
    return getattr(importlib.import_module(HOMES[name]), name)
