"""Blocks whose points are seen on given images, on as many as wanted."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block, CheckPoints, ExteriorOrientation, InteriorOrientation, Rays, Structure
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, observation_group
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import exact_coordinates, simulate

HEIGHT = 1500.0


CAMERA = AerialCamera(principal_distance=100.0, width=104.0, height=68.0, pixel_size=0.006, offset=(0.05, -0.03))


def block_of(tracks: list[np.ndarray], images: int, free: tuple[str, ...], seed: int = 0) -> Block:
    """Images in rows over one small piece of ground, point k seen on the images `tracks[k]`.

    Rays in random order with random weights, observed stations, weighted control on every fourth point, approximate
    values off the truth.
    """
    rng = np.random.default_rng(seed)
    template = simulate(1, 2, camera=CAMERA).truth
    ray_image = np.concatenate(tracks).astype(np.int32)
    ray_point = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks]).astype(np.int32)
    mixed = rng.permutation(len(ray_image))
    k = np.arange(images)
    centres = np.stack([40.0 * (k % 12), 40.0 * (k // 12), np.full(images, HEIGHT)], 1) + rng.normal(0, 5, (images, 3))
    angles = rng.normal(0, 0.2, (images, 3)) + np.array([0.0, 0.0, 1.0]) * rng.uniform(-3, 3, (images, 1))
    extent = centres.max(0)[:2]
    points = np.concatenate([rng.uniform(0, extent, (len(tracks), 2)), rng.uniform(-400, 400, (len(tracks), 1))], 1)
    elements = template.structure.cameras[0].model.elements
    structure = Structure(
        "long tracks",
        template.structure.cameras,
        tuple(f"image {i}" for i in k),
        tuple(f"point {p}" for p in range(len(tracks))),
        np.zeros(images, np.int32),
        ray_image[mixed],
        ray_point[mixed],
        np.ones((images, 6), bool),
        np.array([[element in free for element in elements]]),
        np.ones((len(tracks), 3), bool),
        np.zeros(0, np.int64),
    )
    sigmas = rng.uniform(0.2, 1.0, (len(mixed), 2))
    known = np.arange(0, len(tracks), 4)
    block = Block(
        structure,
        ExteriorOrientation(jnp.asarray(centres), jnp.asarray(angles)),
        InteriorOrientation(template.interior.elements),
        jnp.asarray(points),
        Rays(jnp.zeros(sigmas.shape), jnp.asarray(sigmas)),
        (
            observation_group(CONTROL, known[:, None], points[known], np.full((len(known), 3), 0.05)),
            observation_group(STATIONS, k[:, None], centres, np.full((images, 3), 0.1)),
        ),
        CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )
    coordinates = exact_coordinates(block)[0] + sigmas * rng.normal(size=sigmas.shape)
    return eqx.tree_at(
        lambda b: (b.rays.coordinates, b.object_points, b.exterior.projection_centre, b.exterior.angles),
        block,
        tuple(
            jnp.asarray(x)
            for x in (
                coordinates,
                points + rng.normal(0, 1.0, points.shape),
                centres + rng.normal(0, 1.0, centres.shape),
                angles + rng.normal(0, 1e-3, angles.shape),
            )
        ),
    )
