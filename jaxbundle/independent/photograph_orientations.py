"""Orientations of the photographs from their sensors (models or strips), and the block for another adjustment."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import angles_near
from jaxbundle.geometry.rotation import RotationSystem, from_rotation_vector
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, tree_with
from jaxbundle.orientation.intersection import intersect


class Within(NamedTuple):
    """Images in their sensors: angles of the sensor, rotation of the image within it, and covariances of both."""

    angles: Float[Any, "image 3"]
    covariances: Float[Any, "image 3 3"]
    """Covariances of the angles of the sensor."""
    rotation: Float[Any, "image 3 3"]
    """Matrix sensor_from_image."""
    rotation_covariances: Float[Any, "image 3 3"]
    """Covariances of small rotations about the axes of the sensor."""


class Oriented(NamedTuple):
    """Exterior orientations of the photographs with standard deviations; NaN for images in no sensor."""

    exterior: Float[np.ndarray, "image 6"]
    standard_deviations: Float[np.ndarray, "image 6"]

    @property
    def known(self) -> Bool[np.ndarray, " image"]:
        """Mask of the images that have an orientation."""
        return np.asarray(np.isfinite(self.exterior).all(1))


@Compiled
def _angles(system: RotationSystem, within: Within, reference: Array) -> tuple[Array, Array]:
    """Angles of the images that are nearest to the reference, and their covariances."""

    def one(angles: Array, rotation: Array, near: Array, changes: Array) -> Array:
        sensor = jnp.stack(system.rotation_from_angles(*(angles + changes[:3]))).reshape(3, 3)
        turn = jnp.stack(from_rotation_vector(*changes[3:])).reshape(3, 3)
        return jnp.stack(angles_near(tuple((sensor @ turn @ rotation).ravel()), near, system))

    def both(angles: Array, q: Array, rotation: Array, q_rotation: Array, near: Array) -> tuple[Array, Array]:
        j = jax.jacfwd(lambda d: one(angles, rotation, near, d))(jnp.zeros(6))
        return one(angles, rotation, near, jnp.zeros(6)), j[:, :3] @ q @ j[:, :3].T + j[:, 3:] @ q_rotation @ j[:, 3:].T

    return jax.vmap(both)(*within, reference)


def oriented_angles(block: Block, within: Within) -> tuple[Float[np.ndarray, "image 3"], Float[np.ndarray, "image 3"]]:
    """Angles of the images in the block's rotation system, and their standard deviations."""
    given = Within(*map(on_device, within)), block.exterior.angles
    angles, covariances = _angles(block.structure.rotation_system, *given, optimised=False)
    return np.asarray(angles), np.sqrt(np.diagonal(np.asarray(covariances), axis1=1, axis2=2))


def with_orientations(
    block: Block, oriented: Oriented, points: Float[np.ndarray, "point 3"], parameters: Float[Array, " parameter"]
) -> Block:
    """The photographs with these orientations as approximate values of another adjustment.

    `points`: NaN for points without a sensor, which are then intersected. Fixed values of the photographs are not
        changed.
    """
    s, known = block.structure, oriented.known[:, None]
    exterior = np.hstack([block.exterior.projection_centre, block.exterior.angles])
    exterior = np.where(known & s.exterior_free, oriented.exterior, exterior)
    old = np.asarray(block.object_points)
    changed = tree_with(
        lambda b: (b.exterior.projection_centre, b.exterior.angles, b.object_points, b.parameters),
        block,
        (exterior[:, :3], exterior[:, 3:], np.where(s.point_free, points, old), parameters),
    )
    intersected = np.asarray(intersect(changed).object_points)
    return tree_with(lambda b: b.object_points, changed, np.where(np.isfinite(intersected), intersected, old))
