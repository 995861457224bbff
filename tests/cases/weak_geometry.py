"""A block whose camera model and one of whose observations are the user's own, with parameters of their own."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from cases.all_observations import observed, tie_points

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.camera.model import CameraModel
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import exact_coordinates, simulate

SIGMA = 0.006  # mm


def _bent(interior: tuple, vector: tuple, measured: tuple) -> tuple:
    c, x0, y0, bend = interior
    x, y = -vector[0] / vector[2], -vector[1] / vector[2]
    factor = c * (1 + bend * (x**2 + y**2))
    return x0 + factor * x - measured[0], y0 + factor * y - measured[1]


def _tilted(point: tuple, other: tuple, value: tuple, constants: tuple) -> tuple:
    return (other[2] - point[2] + constants[0] * (other[0] - point[0]) - value[0],)


BENT = CameraModel("bent", ("principal_distance", "x0", "y0", "bend"), _bent)
TILTED = ObservationKind("tilted", ("dh",), ("point", "point"), _tilted, constants=("tilt",))


def bent_block(noise: float) -> Block:
    """A strip with weighted control, self-calibration, a scale bar and a height difference in a tilted system.

    `noise`: errors of the rays over their sigmas.
    """
    camera = AerialCamera(estimate=("principal_distance",))
    block = simulate(1, 3, camera=camera, points_per_image=14, control_sigma=0.05, check_points=0, seed=3).truth
    (camera,) = block.structure.cameras
    structure = dataclasses.replace(
        block.structure,
        cameras=(dataclasses.replace(camera, image_unit="mm", principal_distance_in_mm=False, model=BENT),),
        interior_free=np.array([[True, False, False, False]]),
    )
    block = dataclasses.replace(block, structure=structure)
    block = eqx.tree_at(lambda b: b.interior.elements, block, jnp.array([[150.0, 0.02, -0.01, 0.03]]))
    sigmas = jnp.full(block.rays.sigmas.shape, SIGMA)
    block = eqx.tree_at(lambda b: (b.rays.coordinates, b.rays.sigmas), block, (jnp.zeros(sigmas.shape), sigmas))
    errors = noise * SIGMA * np.random.default_rng(1).standard_normal(sigmas.shape)
    block = eqx.tree_at(lambda b: b.rays.coordinates, block, exact_coordinates(block)[0] + errors)
    tie = tie_points(block)
    block = observed(block, DISTANCES, [[tie[0], tie[3]]], 0.02)
    return observed(block, TILTED, [[tie[1], tie[2]]], 0.02, constants=np.array([[0.1]]))
