"""Aerial strips and blocks with known truth: what an adjustment gives can be held against what it should give.

Image coordinates are those at which the package's own image equation leaves no residual, plus normal errors.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
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
from jaxbundle.block.observations import CONTROL, STATIONS, ObservationGroup, observation_group
from jaxbundle.block.residuals import Observations, observations_of
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.projection import projection
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.numerics.precision import require_float64
from jaxbundle.planning.flight import (
    FRAME_CAMERA,
    SCATTER,
    AerialCamera,
    Flight,
    Incidence,
    control_points,
    flight_of,
    near_pairs,
    stations,
    tie_points,
)

NO_RESIDUAL = 1e-9  # of the format; more is left only where the distortion has no inverse
ROUGH_ANGLE = math.radians(1.0)  # approximate attitudes off the truth; positions are off by SCATTER
LONG = 1.002  # principal distance at the start over the true one, where it is estimated


class Simulation(NamedTuple):
    """`block`: observations and approximate values; `truth`: the same structure with true values and no errors."""

    block: Block
    truth: Block


class _Scene(NamedTuple):
    """True orientations and true object points, of which the first `control` ones are control points."""

    camera: AerialCamera
    centres: Float[np.ndarray, "image 3"]
    angles: Float[np.ndarray, "image 3"]
    points: Float[np.ndarray, "point 3"]
    control: int


class _Order(NamedTuple):
    """What the user asked for besides the flight; control coordinates of sigma 0 are fixed."""

    control_sigmas: Float[np.ndarray, "3"]
    station_sigma: float | None
    check_points: int
    seed: int


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
    """A block of `strips` strips of `images` images each, with known truth; object unit metres.

    `flying_height` is above the mean ground, `relief` the range of heights. `tilt`: standard deviation of omega, phi
    and kappa in degrees. `image_sigma`, unit of the rays, is 0.005 mm or 0.3 px unless given. `control_rows` have
    strips + 1 points each; without rows and stations the first image and X0 of the last one of its strip hold the
    datum, at their true values. `control_sigma` 0 fixes the control points. `station_sigma` adds observed projection
    centres. `check_points` are tie points whose truth is in the block. `noise` scales all errors: with 0 the
    observations are exact.

    Raises: ValueError for a flight whose images have no points in common.
    """
    require_float64()
    flight = flight_of(strips, images, camera, flying_height, (forward_overlap, side_overlap))
    rng = np.random.default_rng(seed)
    centres, angles = stations(flight, math.radians(tilt), rng)
    points = np.concatenate([control_points(flight, control_rows), tie_points(flight, points_per_image, rng)])
    points[:, 2] = relief * rng.uniform(-0.5, 0.5, len(points))
    order = _Order(np.broadcast_to(np.asarray(control_sigma, float), 3), station_sigma, check_points, seed)
    sigma = image_sigma if image_sigma is not None else 0.3 if camera.pixel_size else 0.005

    scene = _Scene(camera, centres, angles, points, control_rows * (strips + 1))
    near = near_pairs(flight, points, relief, math.radians(tilt))
    all_near = _block(scene, _structure(scene, near, flight, order), np.zeros((len(near.image), 2)), sigma, ())
    scene, seen, coordinates = _visible(scene, near, *exact_coordinates(all_near))
    truth = _block(scene, _structure(scene, seen, flight, order), coordinates, sigma, _groups(scene, order))
    return Simulation(_with_approximations(_with_errors(truth, noise, rng), camera, flight, rng), truth)


def exact_coordinates(block: Block) -> tuple[Float[np.ndarray, "ray 2"], Float[np.ndarray, "ray 2"]]:
    """Image coordinates at which every ray's residual vanishes, and what is left of the residual.

    By Newton's method from the principal point, so that any camera model will do; exact at once for models that do not
    correct the measurement.
    """
    coordinates, left = _exact(unknowns_of(block), observations_of(block))
    return np.asarray(coordinates.T), np.asarray(left.T)


@eqx.filter_jit
def _exact(unknowns: Unknowns, observations: Observations) -> tuple[Float[Array, "2 ray"], Float[Array, "2 ray"]]:
    image, point = observations.ray_image, observations.ray_point
    interior = tuple(unknowns.interior[:, observations.image_camera[image]])
    vector = photo_vector(
        tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image]), tuple(unknowns.points[:, point])
    )
    measured = projection(observations.model, interior, vector)
    return jnp.stack(measured), jnp.stack(observations.model.residual(interior, vector, measured))


def _visible(
    scene: _Scene, near: Incidence, coordinates: Float[np.ndarray, "near 2"], left: Float[np.ndarray, "near 2"]
) -> tuple[_Scene, Incidence, Float[np.ndarray, "ray 2"]]:
    """What the images show: points on two images at least, control points on one; the others are left out."""
    camera = scene.camera
    half = np.array([camera.width, camera.height]) / 2 / (camera.pixel_size or 1.0)
    shown = (np.abs(coordinates - camera.centre) <= half) & (np.abs(left) <= NO_RESIDUAL * half)
    ray = shown.all(1)
    rays = np.bincount(near.point[ray], minlength=len(scene.points))
    kept = rays >= np.where(np.arange(len(rays)) < scene.control, 1, 2)
    ray &= kept[near.point]
    number = np.cumsum(kept, dtype=np.int32) - 1
    scene = scene._replace(points=scene.points[kept], control=int(kept[: scene.control].sum()))
    return scene, Incidence(near.image[ray], number[near.point[ray]]), coordinates[ray]


def _structure(scene: _Scene, seen: Incidence, flight: Flight, order: _Order) -> Structure:
    camera, model = scene.camera, scene.camera.model
    names = _image_names(flight)
    point_free = np.ones((len(scene.points), 3), bool)
    point_free[: scene.control, order.control_sigmas == 0] = False
    exterior_free = np.ones((len(names), 6), bool)
    datum = Datum("open")
    if scene.control == 0 and order.station_sigma is None:
        last = flight.images - 1
        exterior_free[0], exterior_free[last, 0] = False, False
        held = [(names[0], element) for element in (*CENTRE_ELEMENTS, *OMEGA_PHI_KAPPA.angles)]
        datum = Datum("fixed", (*held, (names[last], "X0")))
    tie = len(scene.points) - scene.control
    return Structure(
        name=f"{flight.strips} x {flight.images} images",
        cameras=(_camera(camera),),
        image_names=names,
        point_names=tuple(str(k + 1) for k in range(len(scene.points))),
        image_camera=np.zeros(len(names), np.int32),
        ray_image=seen.image,
        ray_point=seen.point,
        exterior_free=exterior_free,
        interior_free=np.array([[element in camera.estimate for element in model.elements]]),
        point_free=point_free,
        check_point=scene.control + (np.arange(order.check_points) + 1) * tie // (order.check_points + 1),
        datum=datum,
        source=f"simulated, seed {order.seed}",
    )


def _camera(camera: AerialCamera) -> Camera:
    if camera.pixel_size is None:
        return Camera("camera", camera.model, "mm")
    width, height = (round(length / camera.pixel_size) for length in (camera.width, camera.height))
    return Camera("camera", camera.model, "px", width, height, metric=True)


def _image_names(flight: Flight) -> tuple[str, ...]:
    """Strip and number in the strip, "1_01"."""
    digits = max(2, len(str(flight.images)))
    return tuple(f"{s + 1}_{k + 1:0{digits}d}" for s in range(flight.strips) for k in range(flight.images))


def _block(
    scene: _Scene,
    structure: Structure,
    coordinates: Float[np.ndarray, "ray 2"],
    sigma: float,
    groups: tuple[ObservationGroup, ...],
) -> Block:
    check = scene.points[structure.check_point]
    return Block(
        structure,
        ExteriorOrientation(jnp.asarray(scene.centres), jnp.asarray(scene.angles)),
        InteriorOrientation(jnp.array([list(scene.camera.interior().values())])),
        jnp.asarray(scene.points),
        Rays(jnp.asarray(coordinates), jnp.full(coordinates.shape, sigma)),
        groups,
        CheckPoints(jnp.asarray(check), jnp.zeros(check.shape)),
    )


def _groups(scene: _Scene, order: _Order) -> tuple[ObservationGroup, ...]:
    """Weighted control coordinates and observed stations, without errors."""
    groups = []
    if scene.control and (order.control_sigmas > 0).any():
        sigmas = np.where(order.control_sigmas > 0, order.control_sigmas, np.nan)
        indices = np.arange(scene.control)[:, None]
        points = scene.points[: scene.control]
        groups.append(observation_group(CONTROL, indices, points, np.broadcast_to(sigmas, points.shape)))
    if order.station_sigma is not None:
        indices = np.arange(len(scene.centres))[:, None]
        sigmas = np.full(scene.centres.shape, order.station_sigma)
        groups.append(observation_group(STATIONS, indices, scene.centres, sigmas))
    return tuple(groups)


def _with_errors(truth: Block, noise: float, rng: np.random.Generator) -> Block:
    """The block with normal errors in everything observed."""

    def measured(values: Array, sigmas: Array, observed: Bool[np.ndarray, "..."] | bool) -> Array:
        return values + jnp.where(observed, noise * sigmas * rng.standard_normal(values.shape), 0.0)

    rays = measured(truth.rays.coordinates, truth.rays.sigmas, True)
    groups = tuple(
        eqx.tree_at(lambda g: g.values, group, measured(group.values, group.sigmas, group.structure.observed))
        for group in truth.groups
    )
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), truth, (rays, groups))


def _with_approximations(block: Block, camera: AerialCamera, flight: Flight, rng: np.random.Generator) -> Block:
    """The block with rough values in place of what is unknown."""
    structure, size = block.structure, SCATTER * flight.height
    rough = np.where(structure.exterior_free, rng.standard_normal(structure.exterior_free.shape), 0.0)
    points = np.where(structure.point_free, size * rng.standard_normal(structure.point_free.shape), 0.0)
    start = dict(zip(("x0", "y0"), camera.centre, strict=True), principal_distance=LONG * camera.principal_distance)
    interior = [
        start.get(element, 0.0) if element in camera.estimate else value for element, value in camera.interior().items()
    ]
    return eqx.tree_at(
        lambda b: (b.exterior, b.interior.elements, b.object_points),
        block,
        (
            ExteriorOrientation(
                block.exterior.projection_centre + size * rough[:, :3],
                block.exterior.angles + ROUGH_ANGLE * rough[:, 3:],
            ),
            jnp.array([interior]),
            block.object_points + points,
        ),
    )
