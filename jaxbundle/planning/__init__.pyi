from jaxbundle.planning.accuracy import (
    Check as Check,
    Specification as Specification,
    check_specification as check_specification,
    in_area as in_area,
    mean_variance as mean_variance,
    smooth_share as smooth_share,
    smooth_worst as smooth_worst,
    summary_of as summary_of,
)
from jaxbundle.planning.control_candidates import candidates_of as candidates_of
from jaxbundle.planning.control_search import Layout as Layout, Objective as Objective, best_layout as best_layout
from jaxbundle.planning.design_derivatives import (
    Stretch as Stretch,
    derivatives_of as derivatives_of,
    steepest_positions as steepest_positions,
    stretched as stretched,
)
from jaxbundle.planning.flight import (
    AerialCamera as AerialCamera,
    ControlSet as ControlSet,
    FlightPlan as FlightPlan,
    GrossErrors as GrossErrors,
    Navigation as Navigation,
    Terrain as Terrain,
    Ties as Ties,
    schematic as schematic,
)
from jaxbundle.planning.monte_carlo_runs import MonteCarlo as MonteCarlo, monte_carlo as monte_carlo
from jaxbundle.planning.prediction import Prediction as Prediction, predict as predict
from jaxbundle.planning.sensitivities import Effect as Effect, Sensitivity as Sensitivity, sensitivity as sensitivity
from jaxbundle.planning.simulation import (
    SimulatedFlight as SimulatedFlight,
    Simulation as Simulation,
    simulate as simulate,
    simulate_flight as simulate_flight,
)
from jaxbundle.planning.terrain import grid_heights as grid_heights, slope as slope, waves as waves
