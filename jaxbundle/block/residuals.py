"""All observations as arrays, and their residuals v = computed - observed.

`Observations` is a second form of a block: only arrays (component first, long axis last) and, as static fields, the
functions that are applied to them. It has no names, so two blocks with equal shapes share one compiled program.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import ObservationGroup, ObservationKind
from jaxbundle.block.unknowns import Unknowns, corrected_in_angles
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.numerics.host import on_device, on_host_or_traced


class Group(eqx.Module):
    """Observations of one kind as arrays.

    `weights` are square roots of the weights, 0 where not observed: one factor per component, or the rows of a lower
    triangle if the components are correlated.
    """

    kind: ObservationKind = eqx.field(static=True)
    indices: Int[Array, "touched member"]
    values: Float[Array, "component member"]
    weights: Float[Array, "component *component member"]
    constants: Float[Array, "constant member"]


class Observations(eqx.Module):
    """All observations, their indices, and masks of free elements; `columns`: interior elements to estimate."""

    model: CameraModel = eqx.field(static=True)
    columns: tuple[int, ...] = eqx.field(static=True)
    system: RotationSystem = eqx.field(static=True)
    image_camera: Int[Array, " image"]
    ray_image: Int[Array, " ray"]
    ray_point: Int[Array, " ray"]
    coordinates: Float[Array, "number ray"]
    weights: Float[Array, "component ray"]
    groups: tuple[Group, ...]
    exterior_free: Bool[Array, "6 image"]
    interior_free: Bool[Array, "column camera"]
    parameter_free: Bool[Array, " parameter"]
    point_free: Bool[Array, "3 point"]
    in_angles: Bool[Array, " image"] | None


def group_arrays(group: ObservationGroup, indices: Int[np.ndarray, "touched member"], size: int | None = None) -> Group:
    """A group as arrays with the long axis last; `indices` in the order of the unknowns.

    Padded to `size` with copies of the first member, whose weights are 0: their residuals are finite. An empty
    group remains empty.
    """
    kind, indices = group.structure.kind, indices.astype(np.int32)
    return Group(kind, *_group_arrays(indices, group.values, group.weights, group.constants, size))


@on_host_or_traced
def _group_arrays(_xp: Any, indices: Any, values: Any, weights: Any, constants: Any, size: int | None) -> tuple:
    weights = weights.T if weights.ndim == 2 else weights.transpose(1, 2, 0)
    if size is not None and len(values):
        member = padded_members(len(values), size)
        indices, values, constants = indices[:, member], values[member], constants[member]
        real = (np.arange(size) < weights.shape[-1]).astype(float)
        weights = weights[..., member] * np.expand_dims(real, tuple(range(weights.ndim - 1)))
    return indices, values.T, weights, constants.T


def padded_members(count: int, size: int) -> Int[np.ndarray, " padded"]:
    """Indices of the members of a group, padded with the first member."""
    member = np.arange(size)
    return np.where(member < count, member, 0)


def observations_of(block: Block) -> Observations:
    """The observations of a block as arrays."""
    structure, in_angles = block.structure, corrected_in_angles(block.structure)
    indices = structure.image_camera, structure.ray_image, structure.ray_point
    free = (
        structure.exterior_free.T,
        structure.interior_free.T[list(structure.interior_columns)],
        structure.parameter_free,
        structure.point_free.T,
        in_angles,
    )
    groups = tuple(group_arrays(group, group.structure.indices.T) for group in block.groups)
    coordinates, weights = _measured(block.rays.coordinates, block.rays.sigmas)
    image_camera, ray_image, ray_point = on_device([index.astype(np.int32) for index in indices])
    return Observations(
        structure.model,
        structure.interior_columns,
        structure.rotation_system,
        image_camera,
        ray_image,
        ray_point,
        coordinates,
        weights,
        groups,
        *on_device(free),
    )


@on_host_or_traced
def _measured(_xp: Any, coordinates: Any, sigmas: Any) -> tuple:
    return coordinates.T, 1 / sigmas.T


def touched_values(unknowns: Unknowns, kind: str, index: Array) -> Any:
    """The scalars of the touched entities as arguments of an observation kind; each has the shape of `index`."""
    if kind == "point":
        return tuple(unknowns.points[:, index])
    if kind == "image":
        return tuple(unknowns.centre[:, index]), tuple(unknowns.rotation[:, index])
    if kind == "parameter":
        return unknowns.parameters[index]
    return tuple(unknowns.interior[:, index])


def group_residuals(unknowns: Unknowns, group: Group) -> Float[Array, "component member"]:
    """Unweighted residuals of a group of observations."""
    touched = tuple(
        touched_values(unknowns, kind, index) for kind, index in zip(group.kind.touches, group.indices, strict=True)
    )
    return jnp.stack(group.kind.residuals(touched, tuple(group.values), tuple(group.constants)))


def weighted(residuals: Float[Array, "component member"], group: Group) -> Float[Array, "component member"]:
    """Residuals times the square roots of their weights: uncorrelated, of unit variance."""
    if group.weights.ndim == 2:
        return residuals * group.weights
    return jnp.sum(group.weights * residuals[None], 1)


def ray_residuals(unknowns: Unknowns, observations: Observations) -> Float[Array, "component ray"]:
    """Residuals of the rays; those of image coordinates in the unit of the rays, y up."""
    image, point = observations.ray_image, observations.ray_point
    vector = photo_vector(
        tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image]), tuple(unknowns.points[:, point])
    )
    interior = tuple(unknowns.interior[:, observations.image_camera[image]])
    return jnp.stack(observations.model.residual(interior, vector, tuple(observations.coordinates)))


def weighted_residuals(
    unknowns: Unknowns, observations: Observations
) -> tuple[Float[Array, "_component _member"], ...]:
    """Residuals over their sigmas: first the rays, then each group; 0 where not observed."""
    rays = ray_residuals(unknowns, observations) * observations.weights
    return rays, *(weighted(group_residuals(unknowns, group), group) for group in observations.groups)
