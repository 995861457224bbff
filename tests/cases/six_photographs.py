"""Six photographs that all show 12 control points and 30 tie points, whose accuracies differ: three groups."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.block.observation_kinds import CONTROL, observation_group
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.planning.simulation import exact_coordinates

PHOTOS, KNOWN, TIES = 6, 12, 30
SIGMAS = np.array([0.008, 0.004, 0.05])  # image coordinates of control points and of tie points [mm], control [m]


def true_block() -> Block:
    """Two strips of three photos, f = 153 mm, 1500 m above ground; observations without errors, true sigmas."""
    rng = np.random.default_rng(1)
    centres = np.array([[900.0 * k, 450.0 * s, 1500.0] for s in (-1, 1) for k in (-1, 0, 1)])
    centres += rng.normal(0, 10, centres.shape)
    angles = rng.normal(0, 0.03, centres.shape)
    points = np.c_[rng.uniform(-1000, 1000, (KNOWN + TIES, 2)), rng.uniform(-100, 100, KNOWN + TIES)]
    image, point = (grid.ravel() for grid in np.indices((PHOTOS, KNOWN + TIES)).astype(np.int32))
    structure = Structure(
        name="six photos",
        cameras=(Camera("camera", CAMERA_MODELS["none"], "mm"),),
        image_names=tuple("ABCDEF"),
        point_names=tuple(str(k + 1) for k in range(len(points))),
        image_camera=np.zeros(PHOTOS, np.int32),
        ray_image=image,
        ray_point=point,
        exterior_free=np.ones((PHOTOS, 6), bool),
        interior_free=np.zeros((1, 5), bool),
        point_free=np.ones(points.shape, bool),
        check_point=np.zeros(0, int),
    )
    sigmas = np.repeat(np.where(point < KNOWN, SIGMAS[0], SIGMAS[1])[:, None], 2, 1)
    known = np.arange(KNOWN)
    block = Block(
        structure,
        ExteriorOrientation(jnp.asarray(centres), jnp.asarray(angles)),
        InteriorOrientation(jnp.array([[153.0, 0, 0, 1, 1]])),
        jnp.asarray(points),
        Rays(jnp.zeros(sigmas.shape), jnp.asarray(sigmas)),
        (observation_group(CONTROL, known[:, None], points[known], np.full((KNOWN, 3), SIGMAS[2])),),
        CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(exact_coordinates(block)[0]))


def with_sigmas(block: Block, rays: float, control: float) -> Block:
    """The block with other sigmas a priori, one for all image coordinates."""
    sigmas = jnp.full(block.rays.sigmas.shape, rays), jnp.full(block.groups[0].sigmas.shape, control)
    return eqx.tree_at(lambda b: (b.rays.sigmas, b.groups[0].sigmas), block, sigmas)


def drawn(block: Block, seed: int) -> Block:
    """The block with normal errors of its sigmas in everything observed."""
    rng = np.random.default_rng(seed)
    rays = block.rays.coordinates + block.rays.sigmas * rng.standard_normal(block.rays.sigmas.shape)
    control = block.groups[0].values + block.groups[0].sigmas * rng.standard_normal(block.groups[0].sigmas.shape)
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups[0].values), block, (rays, control))
