"""A block whose images, points and observations stand in another order."""

import dataclasses

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block, ExteriorOrientation
from jaxbundle.block.observation_kinds import GroupStructure, ObservationGroup


def regrouped(group: ObservationGroup, order: Int[np.ndarray, " member"], number: dict) -> ObservationGroup:
    """The group in another order, of entities that have other numbers."""
    kind, indices, observed = group.structure.kind, group.structure.indices[order], group.structure.observed[order]
    indices = np.stack([number[touched][indices[:, k]] for k, touched in enumerate(kind.touches)], 1)
    structure = GroupStructure(kind, indices, observed)
    return ObservationGroup(structure, group.values[order], group.sigmas[order], group.constants[order])


def shuffled(
    block: Block, rng: np.random.Generator
) -> tuple[Block, Int[np.ndarray, " image"], Int[np.ndarray, " point"]]:
    """The block with images, points, rays and observations in another order, and the orders of images and points."""
    s = block.structure
    image, point, ray = (rng.permutation(len(entities)) for entities in (s.image_names, s.point_names, s.ray_image))
    number = {"image": np.argsort(image).astype(np.int32), "point": np.argsort(point).astype(np.int32)}
    structure = dataclasses.replace(
        s,
        image_names=tuple(s.image_names[k] for k in image),
        point_names=tuple(s.point_names[k] for k in point),
        image_camera=s.image_camera[image],
        ray_image=number["image"][s.ray_image[ray]],
        ray_point=number["point"][s.ray_point[ray]],
        exterior_free=s.exterior_free[image],
        point_free=s.point_free[point],
        check_point=number["point"][s.check_point],
    )
    again = dataclasses.replace(
        block,
        structure=structure,
        exterior=ExteriorOrientation(block.exterior.projection_centre[image], block.exterior.angles[image]),
        object_points=block.object_points[point],
        rays=dataclasses.replace(block.rays, coordinates=block.rays.coordinates[ray], sigmas=block.rays.sigmas[ray]),
        groups=tuple(regrouped(g, rng.permutation(len(g.structure.indices)), number) for g in block.groups),
    )
    return again, image, point
