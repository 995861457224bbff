"""Simulating aerial strips and blocks with known truth, for comparison with results of an adjustment.

Image coordinates have zero residuals of the image equation, plus normal errors.
"""

import math
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.planning.assembly import block_of, structure_of, with_approximations, with_errors, with_gross_errors
from jaxbundle.planning.drawn_flight import Scene, near_pairs, scene_of, shown
from jaxbundle.planning.exact import exact_coordinates
from jaxbundle.planning.flight import (
    FRAME_CAMERA,
    AerialCamera,
    ControlSet,
    FlightPlan,
    Navigation,
    Terrain,
    Ties,
    plan_problems,
)
from jaxbundle.planning.navigation_errors import NOTHING, consistent_groups, navigation_of

__all__ = ["SimulatedFlight", "Simulation", "exact_coordinates", "simulate", "simulate_flight"]


class Simulation(NamedTuple):
    """A simulated block with its truth.

    `block`: observations and approximate values; `truth`: same structure with true values and no errors.

    Example:
        >>> simulation = jb.simulate(1, 4, seed=1)
        >>> simulation.block.structure is simulation.truth.structure
        True
    """

    block: Block
    truth: Block


class SimulatedFlight(NamedTuple):
    """A simulated flight. `block` and `truth` as in a `Simulation`; `gross_errors`: rays with a gross error.

    Example:
        >>> flight.gross_errors.size
        0
    """

    block: Block
    truth: Block
    gross_errors: Int[np.ndarray, " gross"]


def simulate(
    strips: int = 1,
    images: int = 8,
    *,
    camera: AerialCamera = FRAME_CAMERA,
    flying_height: float = 1500.0,
    forward_overlap: float = 0.6,
    side_overlap: float = 0.3,
    relief: float = 150.0,
    tilt: float = 2.0,
    points_per_image: int = 60,
    image_sigma: float | None = None,
    control_rows: int = 2,
    control_sigma: float | tuple[float, float, float] = 0.0,
    station_sigma: float | None = None,
    check_points: int = 4,
    noise: float = 1.0,
    seed: int = 0,
) -> Simulation:
    """Simulates a block of `strips` strips of `images` images each, with known truth; object unit metres.

    `flying_height` is above the mean ground, `relief` the range of heights. `tilt`: standard deviation of omega, phi
    and kappa in degrees. `image_sigma`, in the unit of the rays, is by default 0.005 mm or 0.3 px. `control_rows` have
    strips + 1 points each; without rows and stations the first image and X0 of the last one of its strip define
    the datum, with their true values. `control_sigma` 0 fixes the control points. `station_sigma` adds observed
    projection centres. `check_points` are tie points whose truth is in the block. `noise` scales all errors: with 0 the
    observations are exact. `jaxbundle.planning.simulate_flight` has more options.

    Raises: ValueError for a flight whose images have no points in common.

    Example:
        >>> simulation = jb.simulate(1, 4, seed=1)
        >>> len(simulation.block.images), len(simulation.block.structure.check_point)
        (4, 4)
    """
    x, y, z = np.broadcast_to(np.asarray(control_sigma, float), 3).tolist()
    rows = (ControlSet("rows", sigmas=(x, y, z), count=control_rows),) if control_rows else ()
    stations = None if station_sigma is None else Navigation((station_sigma,) * 3)
    block, truth, _ = simulate_flight(
        FlightPlan(
            strips,
            images,
            camera,
            flying_height,
            forward_overlap,
            side_overlap,
            tilt=math.radians(tilt),
            terrain=Terrain(relief),
            ties=Ties(points_per_image=points_per_image),
            image_sigma=image_sigma,
            control=rows,
            check_points=check_points,
            gnss=stations,
            noise=noise,
            seed=seed,
        )
    )
    return Simulation(block, truth)


def simulate_flight(plan: FlightPlan) -> SimulatedFlight:
    """Simulates the block of a flight, with known truth.

    Args:
        plan: the flight; `schematic` makes one without random deviations.

    Returns: the block with errors and rough approximate values, the truth, and the rays with gross errors. Equal plans
    give equal blocks: all random numbers depend on `plan.seed`.

    Raises: BlockError, a ValueError, with all problems of the plan.

    Example:
        >>> flight = jb.planning.simulate_flight(plan)
        >>> len(flight.block.images)
        3
    """
    prepare_jax()
    problems = plan_problems(plan)
    if problems:
        raise BlockError([Problem(*problem.rsplit("; ", 1), table="flight") for problem in problems])
    rng = np.random.default_rng(plan.seed)
    scene = scene_of(plan, rng)
    near = near_pairs(plan, scene)
    all_near = block_of(plan, scene, structure_of(plan, scene, near, NOTHING), np.zeros((len(near.image), 2)), NOTHING)
    drawn, (scene, seen, coordinates) = scene, shown(plan, scene, near, *exact_coordinates(all_near))
    _require_listed(plan, drawn, scene)
    navigation = navigation_of(plan, scene, rng)
    truth = block_of(plan, scene, structure_of(plan, scene, seen, navigation), coordinates, navigation)
    truth = eqx.tree_at(lambda b: b.groups, truth, consistent_groups(truth))
    block, gross = with_gross_errors(with_errors(truth, plan.noise, rng), plan, rng)
    return SimulatedFlight(with_approximations(block, plan, rng), truth, gross)


def _require_listed(plan: FlightPlan, drawn: Scene, seen: Scene) -> None:
    """Raises BlockError for control and check points of a list that are on no image."""
    listed = [place for control in plan.control if control.layout == "points" for place in control.points]
    listed += [] if isinstance(plan.check_points, int) else list(plan.check_points)
    if plan.ties.layout == "schematic" or not listed:
        return
    lost = {(x, y) for x, y in drawn.points[:, :2].tolist()} - {(x, y) for x, y in seen.points[:, :2].tolist()}
    near = [place for place in listed if any(math.dist(place, other) < 1e-6 * plan.height for other in lost)]
    if near:
        what = f"{len(near)} points of the lists of control and check points are on no image, such as {near[0]}"
        raise BlockError([Problem(what, "correct their coordinates, or change the flight", table="flight")])
