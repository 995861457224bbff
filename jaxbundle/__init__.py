"""A photogrammetric bundle adjuster in JAX, with derivatives through everything.

    import jax; jax.config.update("jax_enable_x64", True)
    import jaxbundle as jb

    block = jb.read("folder")
    result = jb.adjust(block)
    print(result.summary())
    result.standard_deviations.object_points
"""

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.block.changes import with_interior_held
from jaxbundle.block.datum import DatumDefect, datum_defect, with_datum
from jaxbundle.block.observations import (
    CONTROL,
    DISTANCES,
    STATIONS,
    ObservationGroup,
    ObservationKind,
    observation_group,
)
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.validate import validate
from jaxbundle.camera.collinearity import collinearity
from jaxbundle.camera.model import CAMERA_MODELS, CameraModel
from jaxbundle.io import read, read_bal, read_block_folder, write_bal, write_block_folder
from jaxbundle.planning.simulate import Simulation, simulate
from jaxbundle.report import report_dict, report_text, write_report
from jaxbundle.solve.adjust import Progress, adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.stopping import AngleRule, PointRule, parallax_rule, unknown_rule
from jaxbundle.textbook import crosscheck

__all__ = [
    "CAMERA_MODELS",
    "CONTROL",
    "DISTANCES",
    "STATIONS",
    "Adjustment",
    "AngleRule",
    "Block",
    "BlockError",
    "Camera",
    "CameraModel",
    "CheckPoints",
    "Datum",
    "DatumDefect",
    "ExteriorOrientation",
    "InteriorOrientation",
    "ObservationGroup",
    "ObservationKind",
    "PointRule",
    "Problem",
    "Progress",
    "Rays",
    "Simulation",
    "Status",
    "Structure",
    "adjust",
    "collinearity",
    "crosscheck",
    "datum_defect",
    "observation_group",
    "parallax_rule",
    "read",
    "read_bal",
    "read_block_folder",
    "report_dict",
    "report_text",
    "simulate",
    "unknown_rule",
    "validate",
    "with_datum",
    "with_interior_held",
    "write_bal",
    "write_block_folder",
    "write_report",
]
