"""All observations as arrays, and their residuals: v = computed - observed, everywhere.

`Observations` is a block's second form: nothing but arrays (component first, long axis last) and, static, the functions
that are applied to them. Names stay behind, so two blocks of equal shapes share one compiled program.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.observations import ObservationKind
from jaxbundle.block.unknowns import Unknowns, corrected_in_angles
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.numerics.host import on_device, on_host


class Group(eqx.Module):
    """Observations of one kind; `weights` are square roots of the weights, 0 where nothing is observed."""

    kind: ObservationKind = eqx.field(static=True)
    indices: Int[Array, "touched member"]
    values: Float[Array, "component member"]
    weights: Float[Array, "component member"]


class Observations(eqx.Module):
    """Everything observed, who sees what, and what is free; `columns`: interior elements that some camera estimates."""

    model: CameraModel = eqx.field(static=True)
    columns: tuple[int, ...] = eqx.field(static=True)
    system: RotationSystem = eqx.field(static=True)
    image_camera: Int[Array, " image"]
    ray_image: Int[Array, " ray"]
    ray_point: Int[Array, " ray"]
    coordinates: Float[Array, "2 ray"]
    weights: Float[Array, "2 ray"]
    groups: tuple[Group, ...]
    exterior_free: Bool[Array, "6 image"]
    interior_free: Bool[Array, "column camera"]
    point_free: Bool[Array, "3 point"]
    in_angles: Bool[Array, " image"] | None


def observations_of(block: Block) -> Observations:
    """The observations of a block."""
    structure, in_angles = block.structure, corrected_in_angles(block.structure)
    groups = tuple(
        Group(
            group.structure.kind,
            on_device(group.structure.indices.T),
            on_device(on_host(group.values).T),
            on_device(on_host(group.weights).T),
        )
        for group in block.groups
    )
    return Observations(
        structure.model,
        structure.interior_columns,
        structure.rotation_system,
        on_device(structure.image_camera, jnp.int32),
        on_device(structure.ray_image, jnp.int32),
        on_device(structure.ray_point, jnp.int32),
        on_device(on_host(block.rays.coordinates).T),
        on_device(1 / on_host(block.rays.sigmas).T),
        groups,
        on_device(structure.exterior_free.T),
        on_device(structure.interior_free.T[list(structure.interior_columns)]),
        on_device(structure.point_free.T),
        None if in_angles is None else on_device(in_angles),
    )


def touched_values(unknowns: Unknowns, kind: str, index: Array) -> tuple:
    """The scalars of the touched entities, as an observation kind takes them; shape of `index`."""
    if kind == "point":
        return tuple(unknowns.points[:, index])
    if kind == "image":
        return tuple(unknowns.centre[:, index]), tuple(unknowns.rotation[:, index])
    return tuple(unknowns.interior[:, index])


def group_residuals(unknowns: Unknowns, group: Group) -> Float[Array, "component member"]:
    """Unweighted residuals of a group of observations."""
    touched = [
        touched_values(unknowns, kind, index) for kind, index in zip(group.kind.touches, group.indices, strict=True)
    ]
    return jnp.stack(group.kind.residual(*touched, tuple(group.values)))


def ray_residuals(unknowns: Unknowns, observations: Observations) -> Float[Array, "2 ray"]:
    """Residuals of the image coordinates, unit of the rays, y up."""
    image, point = observations.ray_image, observations.ray_point
    vector = photo_vector(
        tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image]), tuple(unknowns.points[:, point])
    )
    interior = tuple(unknowns.interior[:, observations.image_camera[image]])
    return jnp.stack(observations.model.residual(interior, vector, tuple(observations.coordinates)))


def weighted_residuals(unknowns: Unknowns, observations: Observations) -> tuple[Float[Array, "component member"], ...]:
    """Residuals over their sigmas: first the rays, then every group; 0 where nothing is observed."""
    rays = ray_residuals(unknowns, observations) * observations.weights
    return rays, *(group_residuals(unknowns, group) * group.weights for group in observations.groups)
