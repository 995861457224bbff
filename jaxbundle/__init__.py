"""jaxbundle: photogrammetric bundle adjustment in JAX, with derivatives through everything.

    block = jb.read("folder")
    result = jb.adjust(block)
    print(result.summary())

Names are loaded when they are first used: the help of the command line does not wait for JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxbundle.block.block import Block
    from jaxbundle.block.changes import with_interior_held
    from jaxbundle.block.datum import with_datum
    from jaxbundle.block.problems import BlockError
    from jaxbundle.io.bal import read_bal, write_bal
    from jaxbundle.io.block_folder_writer import write_block_folder
    from jaxbundle.io.read import read
    from jaxbundle.planning.flight import AerialCamera
    from jaxbundle.planning.simulate import Simulation, simulate
    from jaxbundle.report.files import write_report
    from jaxbundle.report.findings import findings
    from jaxbundle.report.tables import report_dict
    from jaxbundle.report.text import report_text
    from jaxbundle.solve.adjust import adjust
    from jaxbundle.solve.adjustment import Adjustment, Status
    from jaxbundle.solve.stopping import AngleRule, ParallaxRule, PointRule, UnknownRule, parallax_rule, unknown_rule
    from jaxbundle.textbook.crosscheck import CrossCheck, crosscheck

_MODULES = {
    "block.block": ("Block",),
    "block.changes": ("with_interior_held",),
    "block.datum": ("with_datum",),
    "block.problems": ("BlockError",),
    "io.bal": ("read_bal", "write_bal"),
    "io.block_folder_writer": ("write_block_folder",),
    "io.read": ("read",),
    "planning.flight": ("AerialCamera",),
    "planning.simulate": ("Simulation", "simulate"),
    "report.files": ("write_report",),
    "report.findings": ("findings",),
    "report.tables": ("report_dict",),
    "report.text": ("report_text",),
    "solve.adjust": ("adjust",),
    "solve.adjustment": ("Adjustment", "Status"),
    "solve.stopping": ("AngleRule", "ParallaxRule", "PointRule", "UnknownRule", "parallax_rule", "unknown_rule"),
    "textbook.crosscheck": ("CrossCheck", "crosscheck"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "adjust",
    "Adjustment",
    "AerialCamera",
    "AngleRule",
    "Block",
    "BlockError",
    "CrossCheck",
    "crosscheck",
    "findings",
    "parallax_rule",
    "ParallaxRule",
    "PointRule",
    "read",
    "read_bal",
    "report_dict",
    "report_text",
    "simulate",
    "Simulation",
    "Status",
    "unknown_rule",
    "UnknownRule",
    "with_datum",
    "with_interior_held",
    "write_bal",
    "write_block_folder",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'jaxbundle' has no attribute {name!r}")
    return getattr(importlib.import_module(f"jaxbundle.{_HOME[name]}"), name)
