"""The unknowns of the adjustment and their corrections.

Attitudes are matrices; their corrections are small angles (alpha, omega, kappa) relative to the current matrix,

    R = R_ref R(alpha, omega, kappa),

so no attitude is singular. Only an image with one or two angles fixed by the datum is corrected in the user's angles,
which must be regular at its attitude.

Arrays have the component first and the long axis last.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbundle.block.block import Block, Structure
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import Angles, Rotation, RotationSystem, Scalar
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import is_concrete, on_device, on_host_or_traced
from jaxbundle.numerics.shapes import grid_size


class Unknowns(eqx.Module):
    """Approximate or adjusted values of all elements that may be unknown; rotations object_from_image, rows a, b, c."""

    rotation: Float[Array, "9 image"]
    centre: Float[Array, "3 image"]
    interior: Float[Array, "element camera"]
    parameters: Float[Array, " parameter"]
    points: Float[Array, "3 point"]


class Correction(eqx.Module):
    """Corrections of the unknowns: X0, Y0, Z0 and three angles per image; 0 for fixed elements."""

    exterior: Float[Array, "6 image"]
    interior: Float[Array, "element camera"]
    parameters: Float[Array, " parameter"]
    points: Float[Array, "3 point"]


def unknowns_of(block: Block) -> Unknowns:
    """The approximate values of a block as unknowns."""
    cameras = block.structure.cameras
    models = tuple(dict.fromkeys(camera.model for camera in cameras))
    kinds = np.zeros((0, len(cameras)))
    if len(models) > 1:  # the last element of a mixture selects the model
        kinds = np.array([[models.index(camera.model) for camera in cameras]], float)
    others = block.interior.elements, block.parameters, block.object_points
    return Unknowns(
        _rotations(block.structure.rotation_system, block.exterior.angles),
        *_long_axis_last(kinds, block.exterior.projection_centre, *others),
    )


@on_host_or_traced
def _long_axis_last(xp: Any, kinds: Any, centre: Any, interior: Any, parameters: Any, points: Any) -> tuple:
    return centre.T, xp.concatenate([interior.T, kinds]), parameters, points.T


def _rotations(system: RotationSystem, angles: Float[Array, "image 3"]) -> Float[Array, "9 image"]:
    """Rotation matrices of the images; concrete ones by a compiled program for any number of images."""
    if not is_concrete(angles):
        return jnp.stack(system.rotation_from_angles(*angles.T))
    padded = np.zeros((3, grid_size(len(angles))))
    padded[:, : len(angles)] = np.asarray(angles).T
    with jax.ensure_compile_time_eval():  # also inside jit, where the angles may be constants
        rotations = np.asarray(_compiled_rotations(system, padded, optimised=False))
    return on_device(rotations[:, : len(angles)])


@Compiled
def _compiled_rotations(system: RotationSystem, angles: Float[Array, "3 image"]) -> Float[Array, "9 image"]:
    return jnp.stack(system.rotation_from_angles(*angles))


def corrected_in_angles(structure: Structure) -> Bool[np.ndarray, " image"] | None:
    """Mask of the images with one or two fixed angles, which are corrected in the user's angles; None without any."""
    free = structure.exterior_free[:, 3:].sum(1)
    partly = (free > 0) & (free < 3)
    return partly if partly.any() else None


def _small_rotation(reference: Rotation, alpha: Array, omega: Array, kappa: Array) -> Rotation:
    return rotation.product(reference, rotation.from_alpha_omega_kappa(alpha, omega, kappa))


def _columns(rotation_from_angles: Callable[..., Rotation], angles: Angles) -> Float[Array, "element 3 image"]:
    """Derivatives of the matrix elements with respect to each of three angles, for each image."""
    along = [jnp.stack(jax.jvp(rotation_from_angles, angles, unit)[1]) for unit in _units(angles[0])]
    return jnp.stack(along, 1)


def _units(like: Scalar) -> tuple[Angles, Angles, Angles]:
    one, zero = jnp.ones_like(like), jnp.zeros_like(like)
    return (one, zero, zero), (zero, one, zero), (zero, zero, one)


def attitude_derivatives(
    matrix: Float[Array, "9 image"], in_angles: Bool[Array, " image"] | None, system: RotationSystem
) -> Float[Array, "9 3 image"]:
    """Derivatives of the rotation matrices with respect to the three angles of their corrections."""
    zero = jnp.zeros_like(matrix[0])
    small = _columns(lambda *angles: _small_rotation(tuple(matrix), *angles), (zero, zero, zero))
    if in_angles is None:
        return small
    own = _columns(system.rotation_from_angles, system.angles_from_rotation(tuple(matrix)))
    return jnp.where(in_angles, own, small)


def attitude_curvature(
    matrix: Float[Array, "9 image"], in_angles: Bool[Array, " image"] | None, system: RotationSystem
) -> Float[Array, "9 3 3 image"]:
    """Second derivatives of the rotation matrices with respect to the angles of their corrections."""

    def second(rotation_from_angles: Callable[..., Rotation], angles: Angles) -> Float[Array, "9 3 3 image"]:
        along = [jax.jvp(lambda *a: _columns(rotation_from_angles, a), angles, unit)[1] for unit in _units(angles[0])]
        return jnp.stack(along, 2)

    zero = jnp.zeros_like(matrix[0])
    small = second(lambda *angles: _small_rotation(tuple(matrix), *angles), (zero, zero, zero))
    if in_angles is None:
        return small
    return jnp.where(in_angles, second(system.rotation_from_angles, system.angles_from_rotation(tuple(matrix))), small)


def corrected(
    unknowns: Unknowns, correction: Correction, in_angles: Bool[Array, " image"] | None, system: RotationSystem
) -> Unknowns:
    """The unknowns after a correction."""
    angles = tuple(correction.exterior[3:])
    matrix = jnp.stack(_small_rotation(tuple(unknowns.rotation), *angles))
    if in_angles is not None:
        reference = system.angles_from_rotation(tuple(unknowns.rotation))
        own = jnp.stack(system.rotation_from_angles(*(a + d for a, d in zip(reference, angles, strict=True))))
        matrix = jnp.where(in_angles, own, matrix)
    return Unknowns(
        matrix,
        unknowns.centre + correction.exterior[:3],
        unknowns.interior + correction.interior,
        unknowns.parameters + correction.parameters,
        unknowns.points + correction.points,
    )


def angles_near(matrix: Rotation, reference: Float[Array, "3 *image"], system: RotationSystem) -> Angles:
    """The angles of a matrix that are nearest to the reference.

    Full turns are those of the reference. The second solution (first + 180 deg, 180 deg - middle, last + 180 deg) is
    used if it is nearer.
    """
    first, middle, last = system.angles_from_rotation(matrix)
    solutions = []
    for angles in ((first, middle, last), (first + jnp.pi, jnp.pi - middle, last + jnp.pi)):
        turns = [jnp.round((r - a) / (2 * jnp.pi)) for a, r in zip(angles, reference, strict=True)]
        solutions.append(tuple(a + 2 * jnp.pi * jax.lax.stop_gradient(k) for a, k in zip(angles, turns, strict=True)))
    one, two = (sum(jnp.abs(a - r) for a, r in zip(angles, reference, strict=True)) for angles in solutions)
    nearest = jnp.argmin(jnp.stack([one, two]), 0)  # common to all three angles: see `rotation.to_quaternion`
    x, y, z = (jnp.where(nearest == 0, a, b) for a, b in zip(*solutions, strict=True))
    return x, y, z


def angle_derivatives(
    matrix: Float[Array, "9 image"],
    in_angles: Bool[Array, " image"] | None,
    reference: Float[Array, "3 image"],
    system: RotationSystem,
) -> Float[Array, "3 3 image"]:
    """Derivatives of the user's angles (rows) with respect to the angles of the corrections (columns).

    Not finite at the singular attitude of the user's system, where the two outer angles are undetermined.
    """
    zero = jnp.zeros_like(matrix[0])
    small = _columns(lambda *k: angles_near(_small_rotation(tuple(matrix), *k), reference, system), (zero, zero, zero))
    return small if in_angles is None else jnp.where(in_angles, jnp.eye(3)[:, :, None], small)


def known_centres(block: Block) -> Float[np.ndarray, "image 3"] | None:
    """The projection centres as a hint for the plan of the elimination; None if they are traced."""
    centres = block.exterior.projection_centre
    return np.asarray(centres) if is_concrete(centres) else None


def without_orientation(block: Block) -> Bool[np.ndarray, " image"]:
    """Mask of the images of a concrete block without a coordinate of the projection centre or without an angle."""
    exterior = np.c_[np.asarray(block.exterior.projection_centre), np.asarray(block.exterior.angles)]
    return ~np.isfinite(exterior).all(1)
