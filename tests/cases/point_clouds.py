"""Blocks whose images are no photographs: point clouds that see the object points in three coordinates of their own.

    v = scale R^T (X - X0) - measured            an independent model: 7 unknowns, 3 residuals per point

or with the polynomial of a strip in place of the scale alone, and residuals that are correlated (their factor L^-1
stands behind the measured coordinates).
"""

import jax.numpy as jnp
import numpy as np

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
from jaxbundle.block.observation_kinds import CONTROL, observation_group
from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, Scalar, apply, transpose

MODELS, POINTS = 8, 90


def _model(interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    (scale,) = interior
    return tuple(scale * a - b for a, b in zip(p, measured, strict=True))


def _correlated_strip(interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    scale, bend, twist = interior
    x, y, z = p
    bent = x, y + twist * x * z, z + bend * x * x
    x, y, z = (scale * a - b for a, b in zip(bent, measured[:3], strict=True))
    f11, f21, f22, f31, f32, f33 = measured[3:]
    return f11 * x, f21 * x + f22 * y, f31 * x + f32 * y + f33 * z


MODEL = CameraModel("model", ("scale",), _model, components=3, numbers=3)
STRIP = CameraModel("correlated strip", ("scale", "bend", "twist"), _correlated_strip, components=3, numbers=9)


def point_clouds(sensor: CameraModel, shared: bool = False, seed: int = 3) -> Block:
    """Clouds along a strip, each with a scale of its own or all with the same, and weighted and fixed control."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, -20, -5], [10.0 * MODELS, 20, 5], (POINTS, 3))
    centres = np.stack([10.0 * np.arange(MODELS) + 5, rng.normal(0, 2, MODELS), rng.normal(20, 2, MODELS)], 1)
    angles = rng.normal(0, 0.2, (MODELS, 3))
    count = 1 if shared else MODELS
    camera = np.zeros(MODELS, np.int32) if shared else np.arange(MODELS, dtype=np.int32)
    typical = {"scale": (0.01, 1e-3), "bend": (0.0, 1e-4), "twist": (0.0, 1e-4)}
    interior = np.stack([rng.normal(*typical[name], count) for name in sensor.elements], 1)
    near = np.abs(points[None, :, 0] - centres[:, None, 0]) < 14
    image, point = np.nonzero(near)
    rotation = OMEGA_PHI_KAPPA.rotation_from_angles(*angles[image].T)
    seen = apply(transpose(rotation), tuple((points[point] - centres[image]).T))
    measured = np.zeros((len(image), sensor.numbers))
    if sensor is STRIP:
        measured[:, 3:] = [1.0, 0.4, 1.2, -0.3, 0.2, 0.8]
    exact = np.stack(sensor.residual(tuple(interior[camera[image]].T), seen, tuple(measured.T)), 1)
    if sensor is STRIP:
        factor = np.array([[1.0, 0, 0], [0.4, 1.2, 0], [-0.3, 0.2, 0.8]])
        exact = np.linalg.solve(factor, exact.T).T
    sigma = 0.0001
    measured[:, :3] = exact + rng.normal(0, sigma, exact.shape)
    control = np.array([0, 1, 2, 3, 4, 5, 6, 7])
    sigmas = np.full((len(control), 3), 0.02)
    free = np.ones((POINTS, 3), bool)
    free[7] = False
    group = observation_group(CONTROL, control[:7, None], points[control[:7]] + rng.normal(0, 0.02, (7, 3)), sigmas[:7])
    structure = Structure(
        name="point clouds",
        cameras=tuple(Camera(f"c{k}", sensor, "mm") for k in range(count)),
        image_names=tuple(f"m{k}" for k in range(MODELS)),
        point_names=tuple(f"p{k}" for k in range(POINTS)),
        image_camera=camera,
        ray_image=image.astype(np.int32),
        ray_point=point.astype(np.int32),
        exterior_free=np.ones((MODELS, 6), bool),
        interior_free=np.ones((count, len(sensor.elements)), bool),
        point_free=free,
        check_point=np.zeros(0, np.int32),
        datum=Datum("control"),
    )
    start = points + np.where(free, rng.normal(0, 0.05, points.shape), 0.0)
    return Block(
        structure,
        ExteriorOrientation(
            jnp.asarray(centres + rng.normal(0, 0.05, centres.shape)),
            jnp.asarray(angles + rng.normal(0, 0.002, angles.shape)),
        ),
        InteriorOrientation(jnp.asarray(interior + rng.normal(0, 1e-6, interior.shape))),
        jnp.asarray(start),
        Rays(jnp.asarray(measured), jnp.full((len(image), 3), sigma)),
        (group,),
        CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )
