"""Making a block of a drawn flight: structure, observations, errors, and rough approximate values."""

import math

import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import (
    CENTRE_ELEMENTS,
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.block.observation_kinds import CONTROL, ObservationGroup, observation_group
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.numerics.host import on_device, tree_with
from jaxbundle.planning.drawn_flight import Incidence, Scene
from jaxbundle.planning.flight import SCATTER, AerialCamera, FlightPlan
from jaxbundle.planning.navigation_errors import Observed

ROUGH_ANGLE = math.radians(1.0)  # errors of approximate attitudes; errors of positions are SCATTER
LONG = 1.002  # ratio of approximate and true principal distance, if it is estimated


def structure_of(plan: FlightPlan, scene: Scene, seen: Incidence, navigation: Observed) -> Structure:
    """The structure: names, indices and masks of the unknowns."""
    camera, model = plan.camera, plan.camera.model
    names = scene.stations.names
    exterior_free = np.ones((len(names), 6), bool)
    datum = Datum("open")
    if not scene.is_control.any() and plan.gnss is None:
        last = int((scene.stations.strip == 0).sum()) - 1
        exterior_free[0], exterior_free[last, 0] = False, False
        held = [(names[0], element) for element in (*CENTRE_ELEMENTS, *OMEGA_PHI_KAPPA.angles)]
        datum = Datum("fixed", (*held, (names[last], "X0")))
    return Structure(
        name=plan.name or f"{plan.strips} x {plan.images} images",
        cameras=(_camera(camera),),
        image_names=names,
        point_names=tuple(str(k + 1) for k in range(len(scene.points))),
        image_camera=np.zeros(len(names), np.int32),
        ray_image=seen.image,
        ray_point=seen.point,
        exterior_free=exterior_free,
        interior_free=np.array([[element in camera.estimate for element in model.elements]]),
        point_free=scene.control != 0,
        check_point=_check_points(plan, scene),
        datum=datum,
        parameters=navigation.parameters,
        source=f"simulated, seed {plan.seed}",
    )


def _check_points(plan: FlightPlan, scene: Scene) -> np.ndarray:
    """Check points of the list, or tie points at equal distances in the order of all."""
    if not isinstance(plan.check_points, int):
        return np.flatnonzero(scene.listed_check)
    control = int(scene.is_control.sum())
    tie = len(scene.points) - control
    return control + (np.arange(plan.check_points) + 1) * tie // (plan.check_points + 1)


def _camera(camera: AerialCamera) -> Camera:
    if camera.pixel_size is None:
        return Camera("camera", camera.model, "mm")
    width, height = (round(length / camera.pixel_size) for length in (camera.width, camera.height))
    return Camera("camera", camera.model, "px", width, height, principal_distance_in_mm=True)


def block_of(
    plan: FlightPlan,
    scene: Scene,
    structure: Structure,
    coordinates: Float[np.ndarray, "ray 2"],
    navigation: Observed,
) -> Block:
    """The block at its true values, observations without errors."""
    check, interior = scene.points[structure.check_point], np.array([list(plan.camera.interior().values())], float)
    sigmas = np.full(coordinates.shape, plan.sigma, float)
    return Block(
        structure,
        ExteriorOrientation(*on_device((scene.centres, scene.angles))),
        InteriorOrientation(on_device(interior)),
        on_device(scene.points),
        Rays(*on_device((coordinates, sigmas))),
        (*_control(scene), *navigation.groups),
        CheckPoints(*on_device((check, np.zeros(check.shape)))),
        on_device(navigation.values),
    )


def _control(scene: Scene) -> tuple[ObservationGroup, ...]:
    """Weighted control coordinates, without errors."""
    weighted = scene.control > 0
    members = np.flatnonzero(weighted.any(1))
    if not len(members):
        return ()
    sigmas = np.where(weighted, scene.control, np.nan)[members]
    return (observation_group(CONTROL, members[:, None], scene.points[members], sigmas),)


def with_errors(truth: Block, noise: float, rng: np.random.Generator) -> Block:
    """The block with normal errors of all observations."""

    def measured(values: Array, sigmas: Array, observed: Bool[np.ndarray, "..."] | bool) -> np.ndarray:
        errors = noise * np.asarray(sigmas) * rng.standard_normal(values.shape)
        return np.asarray(values) + np.where(observed, errors, 0.0)

    rays = measured(truth.rays.coordinates, truth.rays.sigmas, True)
    groups = tuple(
        tree_with(lambda g: g.values, group, measured(group.values, group.sigmas, group.structure.observed))
        for group in truth.groups
    )
    return tree_with(lambda b: (b.rays.coordinates, b.groups), truth, (rays, groups))


def with_gross_errors(block: Block, plan: FlightPlan, rng: np.random.Generator) -> tuple[Block, np.ndarray]:
    """The block with gross errors of some rays, and these rays."""
    count = round(plan.gross_errors.share * len(block.structure.ray_image))
    if not count:
        return block, np.zeros(0, int)
    rays = np.sort(rng.choice(len(block.structure.ray_image), count, replace=False))
    errors = np.zeros(block.rays.coordinates.shape)
    sign, component = rng.choice([-1.0, 1.0], count), rng.integers(0, 2, count)
    errors[rays, component] = sign * plan.gross_errors.size * plan.sigma
    return tree_with(lambda b: b.rays.coordinates, block, np.asarray(block.rays.coordinates) + errors), rays


def with_approximations(block: Block, plan: FlightPlan, rng: np.random.Generator) -> Block:
    """The block with approximate values for unknowns and given values for fixed elements."""
    structure, size, camera = block.structure, SCATTER * plan.height, plan.camera
    rough = np.where(structure.exterior_free, rng.standard_normal(structure.exterior_free.shape), 0.0)
    points = np.where(structure.point_free, size * rng.standard_normal(structure.point_free.shape), 0.0)
    start = dict(zip(("x0", "y0"), camera.centre, strict=True), principal_distance=LONG * camera.principal_distance)
    interior = [
        start.get(element, 0.0) if element in camera.estimate else value for element, value in camera.given().items()
    ]
    centres, angles, own_points, parameters = (
        np.asarray(x)
        for x in (block.exterior.projection_centre, block.exterior.angles, block.object_points, block.parameters)
    )
    return tree_with(
        lambda b: (b.exterior.projection_centre, b.exterior.angles, b.interior.elements, b.object_points, b.parameters),
        block,
        (
            centres + size * rough[:, :3],
            angles + ROUGH_ANGLE * rough[:, 3:],
            np.array([interior], float),
            own_points + points,
            np.where(structure.parameter_free, 0.0, parameters),
        ),
    )
