"""Accuracy before the flight: simulated flights, their predicted precision, and the design of their control.

flight           what a flight is: camera, strips, terrain, tie points, control, navigation, errors
lines, ground    where images are taken from; where points lie
scene            a flight drawn: true orientations and points, who sees whom
navigation       observed centres and attitudes with their systematic errors
assembly, exact  the block of a scene; image coordinates without residuals
simulate         a block with known truth
predict          covariance of a block without noise and without a solve
accuracy         measures of a prediction, and the check of a specification
monte_carlo      many complete adjustments against the prediction
design           derivatives of a measure by positions, sigmas, overlaps and height
candidates       covariances of a block with the places where control may stand
control_search   exchange of control points on the covariance; lower bound of all layouts
sensitivity      derivatives of an adjusted coordinate by everything it was adjusted from
"""

from jaxbundle.planning.accuracy import (
    Check,
    Specification,
    check_specification,
    in_area,
    mean_variance,
    smooth_share,
    smooth_worst,
    summary_of,
)
from jaxbundle.planning.candidates import candidates_of
from jaxbundle.planning.control_search import Layout, Objective, best_layout
from jaxbundle.planning.design import Stretch, derivatives_of, steepest_positions, stretched
from jaxbundle.planning.flight import (
    AerialCamera,
    ControlSet,
    FlightPlan,
    GrossErrors,
    Navigation,
    Terrain,
    Ties,
    schematic,
)
from jaxbundle.planning.monte_carlo import MonteCarlo, monte_carlo
from jaxbundle.planning.predict import Prediction, predict
from jaxbundle.planning.sensitivity import Effect, Sensitivity, sensitivity
from jaxbundle.planning.simulate import SimulatedFlight, Simulation, simulate, simulate_flight
from jaxbundle.planning.terrain import grid_heights, slope, waves

__all__ = [
    "AerialCamera",
    "Check",
    "ControlSet",
    "Effect",
    "FlightPlan",
    "GrossErrors",
    "Layout",
    "MonteCarlo",
    "Navigation",
    "Objective",
    "Prediction",
    "Sensitivity",
    "SimulatedFlight",
    "Simulation",
    "Specification",
    "Stretch",
    "Terrain",
    "Ties",
    "best_layout",
    "candidates_of",
    "check_specification",
    "derivatives_of",
    "grid_heights",
    "in_area",
    "mean_variance",
    "monte_carlo",
    "predict",
    "schematic",
    "sensitivity",
    "simulate",
    "simulate_flight",
    "slope",
    "smooth_share",
    "smooth_worst",
    "steepest_positions",
    "stretched",
    "summary_of",
    "waves",
]
