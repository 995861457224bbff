"""Variants of the simulated block: what is shared, held or not eliminated."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observation_kinds import observation_group
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE


def changed(block: Block, **changes: object) -> Block:
    """The block with another structure."""
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, **changes))


def with_distances(block: Block) -> Block:
    """Distances between tie points, and from a control point to a tie point: those points are not eliminated."""
    structure = block.structure
    tie = np.flatnonzero(structure.point_free.all(1) & (np.bincount(structure.ray_point) > 2))
    pairs = np.array([[tie[0], tie[5]], [0, tie[2]], [tie[5], tie[9]]])
    lengths = np.linalg.norm(np.diff(np.asarray(block.object_points)[pairs], axis=1)[:, 0], axis=1)
    group = observation_group(DISTANCES, pairs, lengths[:, None] + 0.5, np.full((3, 1), 0.02))
    return dataclasses.replace(block, groups=(*block.groups, group))


def with_private_cameras(block: Block) -> Block:
    """Every image has a camera of its own, of which every second one is self-calibrated."""
    images = len(block.structure.image_names)
    (camera,) = block.structure.cameras
    cameras = tuple(dataclasses.replace(camera, name=f"camera {k}") for k in range(images))
    free = np.repeat(block.structure.interior_free, images, 0)
    free[::2] = False
    block = changed(block, cameras=cameras, image_camera=np.arange(images, dtype=np.int32), interior_free=free)
    elements = jnp.repeat(block.interior.elements, images, 0)
    return eqx.tree_at(lambda b: b.interior.elements, block, elements)


def with_held_angles(block: Block) -> Block:
    """One image keeps an angle, another one two, a third one its whole orientation."""
    free = block.structure.exterior_free.copy()
    free[1, 4] = free[2, 3] = free[2, 5] = False
    free[6] = False
    return changed(block, exterior_free=free)


def with_two_models(block: Block) -> Block:
    """The second strip is taken with a camera without distortion, of which the principal distance is estimated."""
    (camera,) = block.structure.cameras
    second = dataclasses.replace(camera, name="second", model=DISTORTION_FREE)
    strip = np.array([name.startswith("2") for name in block.structure.image_names])
    free = np.zeros((2, len(BROWN.elements)), bool)
    free[0], free[1, 0] = block.structure.interior_free[0], True
    block = changed(block, cameras=(camera, second), image_camera=strip.astype(np.int32), interior_free=free)
    by_name = dict(zip(BROWN.elements, block.interior.elements[0], strict=True))
    own = [by_name[name] for name in DISTORTION_FREE.elements]
    padded = jnp.array([*own, *[1.0] * (len(BROWN.elements) - len(own))])
    return eqx.tree_at(lambda b: b.interior.elements, block, jnp.stack([block.interior.elements[0], padded]))


BLOCKS = {
    "shared cameras": lambda block: with_two_models(with_held_angles(with_distances(block))),
    "private cameras": lambda block: with_distances(with_private_cameras(block)),
}
