"""A photogrammetric bundle adjuster in JAX, with derivatives through everything.

    import jax; jax.config.update("jax_enable_x64", True)
    import jaxbundle as jb

    block = jb.read("folder")
    result = jb.adjust(block)
    print(result.summary())
    result.standard_deviations.object_points

Names are loaded when they are first used: the help of the command line does not wait for JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxbundle import imagery, measuring
    from jaxbundle.approximate.absolute_orientation import AbsoluteOrientation, absolute_orientation
    from jaxbundle.approximate.intersection import intersect
    from jaxbundle.approximate.relative_orientation import RelativeOrientation, relative_orientation
    from jaxbundle.approximate.resection import Resection, resection
    from jaxbundle.approximate.three_point_resection import ThreePointResection, three_point_resection
    from jaxbundle.block.block import (
        Block,
        Camera,
        CheckPoints,
        Datum,
        ExteriorOrientation,
        InteriorOrientation,
        Parameter,
        Rays,
        Structure,
    )
    from jaxbundle.block.changes import with_interior_held
    from jaxbundle.block.datum import with_datum
    from jaxbundle.block.datum_defect import DatumDefect, datum_defect
    from jaxbundle.block.findings import Finding, Severity
    from jaxbundle.block.geodetic import DISTANCES, LINES, PLANES, geodetic_kind
    from jaxbundle.block.navigation import ATTITUDES, GNSS
    from jaxbundle.block.observations import (
        CONTROL,
        PARAMETERS,
        STATIONS,
        ObservationGroup,
        ObservationKind,
        interior_priors,
        observation_group,
    )
    from jaxbundle.block.problems import BlockError, Problem
    from jaxbundle.block.validate import validate
    from jaxbundle.camera.collinearity import collinearity
    from jaxbundle.camera.corrections import curvature_coefficient, refraction_coefficient, with_corrections
    from jaxbundle.camera.fiducials import FiducialError, InnerOrientation, inner_orientation
    from jaxbundle.camera.model import CameraModel
    from jaxbundle.camera.registry import CAMERA_MODELS
    from jaxbundle.diagnosis.adjusted import findings
    from jaxbundle.diagnosis.before import plausibility, prepared
    from jaxbundle.geometry.similarity import Similarity
    from jaxbundle.io import read, read_bal, read_block_folder, write_bal, write_block_folder
    from jaxbundle.planning.flight import AerialCamera
    from jaxbundle.planning.simulate import Simulation, simulate
    from jaxbundle.report import report_dict, report_text, write_report
    from jaxbundle.solve.adjust import Progress, adjust
    from jaxbundle.solve.adjustment import Adjustment, Status
    from jaxbundle.solve.batch import Batch, Outcome, adjust_many
    from jaxbundle.solve.options import Options
    from jaxbundle.solve.stopping import AngleRule, PointRule, parallax_rule, unknown_rule
    from jaxbundle.solve.weight_functions import Cauchy, Danish, Huber, Tukey
    from jaxbundle.statistics.components import VarianceComponents, variance_components
    from jaxbundle.statistics.influence import control_influence, influence
    from jaxbundle.statistics.precision import covariance_of, error_ellipses, error_ellipsoids
    from jaxbundle.statistics.reliability import Reliability, reliability
    from jaxbundle.statistics.snooping import Snooping, snoop
    from jaxbundle.statistics.subsets import (
        Subset,
        all_control,
        camera_rays,
        control_point,
        control_rays,
        image_rays,
        observations_of_kind,
        three_groups,
        tie_rays,
    )
    from jaxbundle.textbook import crosscheck

__version__ = "0.1.0"

_MODULES = {
    "approximate.absolute_orientation": ("AbsoluteOrientation", "absolute_orientation"),
    "approximate.intersection": ("intersect",),
    "approximate.relative_orientation": ("RelativeOrientation", "relative_orientation"),
    "approximate.resection": ("Resection", "resection"),
    "approximate.three_point_resection": ("ThreePointResection", "three_point_resection"),
    "block.block": (
        "Block",
        "Camera",
        "CheckPoints",
        "Datum",
        "ExteriorOrientation",
        "InteriorOrientation",
        "Parameter",
        "Rays",
        "Structure",
    ),
    "block.changes": ("with_interior_held",),
    "block.datum": ("with_datum",),
    "block.datum_defect": ("DatumDefect", "datum_defect"),
    "block.findings": ("Finding", "Severity"),
    "block.geodetic": ("DISTANCES", "LINES", "PLANES", "geodetic_kind"),
    "block.navigation": ("ATTITUDES", "GNSS"),
    "block.observations": (
        "CONTROL",
        "PARAMETERS",
        "STATIONS",
        "ObservationGroup",
        "ObservationKind",
        "interior_priors",
        "observation_group",
    ),
    "block.problems": ("BlockError", "Problem"),
    "block.validate": ("validate",),
    "camera.collinearity": ("collinearity",),
    "camera.corrections": ("curvature_coefficient", "refraction_coefficient", "with_corrections"),
    "camera.fiducials": ("FiducialError", "InnerOrientation", "inner_orientation"),
    "camera.model": ("CameraModel",),
    "camera.registry": ("CAMERA_MODELS",),
    "diagnosis.adjusted": ("findings",),
    "diagnosis.before": ("plausibility", "prepared"),
    "geometry.similarity": ("Similarity",),
    "io": ("read", "read_bal", "read_block_folder", "write_bal", "write_block_folder"),
    "planning.flight": ("AerialCamera",),
    "planning.simulate": ("Simulation", "simulate"),
    "report": ("report_dict", "report_text", "write_report"),
    "solve.adjust": ("Progress", "adjust"),
    "solve.adjustment": ("Adjustment", "Status"),
    "solve.batch": ("Batch", "Outcome", "adjust_many"),
    "solve.options": ("Options",),
    "solve.stopping": ("AngleRule", "PointRule", "parallax_rule", "unknown_rule"),
    "solve.weight_functions": ("Cauchy", "Danish", "Huber", "Tukey"),
    "statistics.components": ("VarianceComponents", "variance_components"),
    "statistics.influence": ("control_influence", "influence"),
    "statistics.precision": ("covariance_of", "error_ellipses", "error_ellipsoids"),
    "statistics.reliability": ("Reliability", "reliability"),
    "statistics.snooping": ("Snooping", "snoop"),
    "statistics.subsets": (
        "Subset",
        "all_control",
        "camera_rays",
        "control_point",
        "control_rays",
        "image_rays",
        "observations_of_kind",
        "three_groups",
        "tie_rays",
    ),
    "textbook": ("crosscheck",),
}
_ROOMS = ("imagery", "measuring")  # names that stand behind the name of their folder
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "ATTITUDES",
    "CAMERA_MODELS",
    "CONTROL",
    "DISTANCES",
    "GNSS",
    "LINES",
    "PARAMETERS",
    "PLANES",
    "STATIONS",
    "AbsoluteOrientation",
    "Adjustment",
    "AerialCamera",
    "AngleRule",
    "Batch",
    "Block",
    "BlockError",
    "Camera",
    "CameraModel",
    "Cauchy",
    "CheckPoints",
    "Danish",
    "Datum",
    "DatumDefect",
    "ExteriorOrientation",
    "FiducialError",
    "Finding",
    "Huber",
    "InnerOrientation",
    "InteriorOrientation",
    "ObservationGroup",
    "ObservationKind",
    "Options",
    "Outcome",
    "Parameter",
    "PointRule",
    "Problem",
    "Progress",
    "Rays",
    "RelativeOrientation",
    "Reliability",
    "Resection",
    "Severity",
    "Similarity",
    "Simulation",
    "Snooping",
    "Status",
    "Structure",
    "Subset",
    "ThreePointResection",
    "Tukey",
    "VarianceComponents",
    "absolute_orientation",
    "adjust",
    "adjust_many",
    "all_control",
    "camera_rays",
    "collinearity",
    "control_influence",
    "control_point",
    "control_rays",
    "covariance_of",
    "crosscheck",
    "curvature_coefficient",
    "datum_defect",
    "error_ellipses",
    "error_ellipsoids",
    "findings",
    "geodetic_kind",
    "image_rays",
    "imagery",
    "influence",
    "inner_orientation",
    "interior_priors",
    "intersect",
    "measuring",
    "observation_group",
    "observations_of_kind",
    "parallax_rule",
    "plausibility",
    "prepared",
    "read",
    "read_bal",
    "read_block_folder",
    "refraction_coefficient",
    "relative_orientation",
    "reliability",
    "report_dict",
    "report_text",
    "resection",
    "simulate",
    "snoop",
    "three_groups",
    "three_point_resection",
    "tie_rays",
    "unknown_rule",
    "validate",
    "variance_components",
    "with_corrections",
    "with_datum",
    "with_interior_held",
    "write_bal",
    "write_block_folder",
    "write_report",
]


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"jaxbundle.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'jaxbundle' has no attribute {name!r}")
    return getattr(importlib.import_module(f"jaxbundle.{_HOME[name]}"), name)
