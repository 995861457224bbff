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
    from jaxbundle import imagery, measuring, planning
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
    from jaxbundle.independent.adjust_models import ModelAdjustment, adjust_models
    from jaxbundle.independent.adjust_strips import StripAdjustment, adjust_strips
    from jaxbundle.independent.plan_height import PlanHeight, plan_height
    from jaxbundle.io import (
        Sources,
        export,
        read,
        read_bal,
        read_block_folder,
        read_flight,
        write_bal,
        write_block_folder,
        write_format,
    )
    from jaxbundle.orientation.absolute_orientation import AbsoluteOrientation, absolute_orientation
    from jaxbundle.orientation.approximation import Approximation
    from jaxbundle.orientation.direct_linear_transformation import (
        DirectLinearTransformation,
        direct_linear_transformation,
    )
    from jaxbundle.orientation.from_nothing import approximate
    from jaxbundle.orientation.intersection import intersect
    from jaxbundle.orientation.planar_resection import PlanarResection, planar_resection
    from jaxbundle.orientation.relative_orientation import RelativeOrientation, relative_orientation
    from jaxbundle.orientation.resection import Resection, resection
    from jaxbundle.orientation.three_point_resection import ThreePointResection, three_point_resection
    from jaxbundle.planning.flight import AerialCamera
    from jaxbundle.planning.predict import Prediction, predict
    from jaxbundle.planning.simulate import Simulation, simulate
    from jaxbundle.report import (
        compare_reports,
        congruency,
        report_dict,
        report_html,
        report_text,
        survey_congruency,
        to_ply,
        to_rerun,
        write_html,
        write_method_report,
        write_report,
    )
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
    "orientation.approximation": ("Approximation",),
    "orientation.direct_linear_transformation": ("DirectLinearTransformation", "direct_linear_transformation"),
    "orientation.from_nothing": ("approximate",),
    "orientation.planar_resection": ("PlanarResection", "planar_resection"),
    "orientation.absolute_orientation": ("AbsoluteOrientation", "absolute_orientation"),
    "orientation.intersection": ("intersect",),
    "orientation.relative_orientation": ("RelativeOrientation", "relative_orientation"),
    "orientation.resection": ("Resection", "resection"),
    "orientation.three_point_resection": ("ThreePointResection", "three_point_resection"),
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
    "independent.adjust_models": ("ModelAdjustment", "adjust_models"),
    "independent.adjust_strips": ("StripAdjustment", "adjust_strips"),
    "independent.plan_height": ("PlanHeight", "plan_height"),
    "io": (
        "Sources",
        "export",
        "read",
        "read_bal",
        "read_block_folder",
        "read_flight",
        "write_bal",
        "write_block_folder",
        "write_format",
    ),
    "planning.flight": ("AerialCamera",),
    "planning.predict": ("Prediction", "predict"),
    "planning.simulate": ("Simulation", "simulate"),
    "report": (
        "compare_reports",
        "congruency",
        "report_dict",
        "report_html",
        "report_text",
        "survey_congruency",
        "to_ply",
        "to_rerun",
        "write_html",
        "write_method_report",
        "write_report",
    ),
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
# namespaces of their own, which may need packages that are not there
_SUBMODULES = {"imagery": "imagery", "measuring": "measuring", "planning": "planning", "plot": "report.plot"}
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
    "Approximation",
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
    "DirectLinearTransformation",
    "ExteriorOrientation",
    "FiducialError",
    "Finding",
    "Huber",
    "InnerOrientation",
    "InteriorOrientation",
    "ModelAdjustment",
    "ObservationGroup",
    "ObservationKind",
    "Options",
    "Outcome",
    "Parameter",
    "PlanHeight",
    "PlanarResection",
    "PointRule",
    "Prediction",
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
    "Sources",
    "Status",
    "StripAdjustment",
    "Structure",
    "Subset",
    "ThreePointResection",
    "Tukey",
    "VarianceComponents",
    "absolute_orientation",
    "adjust",
    "adjust_many",
    "adjust_models",
    "adjust_strips",
    "all_control",
    "approximate",
    "camera_rays",
    "collinearity",
    "compare_reports",
    "congruency",
    "control_influence",
    "control_point",
    "control_rays",
    "covariance_of",
    "crosscheck",
    "curvature_coefficient",
    "datum_defect",
    "direct_linear_transformation",
    "error_ellipses",
    "export",
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
    "planning",
    "plan_height",
    "planar_resection",
    "plausibility",
    "predict",
    "prepared",
    "read",
    "read_bal",
    "read_block_folder",
    "read_flight",
    "refraction_coefficient",
    "relative_orientation",
    "reliability",
    "report_dict",
    "report_html",
    "report_text",
    "survey_congruency",
    "resection",
    "simulate",
    "snoop",
    "three_groups",
    "three_point_resection",
    "tie_rays",
    "to_ply",
    "to_rerun",
    "unknown_rule",
    "validate",
    "variance_components",
    "with_corrections",
    "with_datum",
    "with_interior_held",
    "write_bal",
    "write_block_folder",
    "write_method_report",
    "write_format",
    "write_html",
    "write_report",
]


def __dir__() -> list[str]:
    return sorted({*__all__, *_SUBMODULES, "__version__"})


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return importlib.import_module(f"jaxbundle.{_SUBMODULES[name]}")
    if name not in _HOME:
        raise AttributeError(f"module 'jaxbundle' has no attribute {name!r}")
    return getattr(importlib.import_module(f"jaxbundle.{_HOME[name]}"), name)
