"""Incidence of the observations: points of the border, images connected by an observation, views in slots."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.normals.plan.tiling import SLOTS

BORDER_SHARE = 0.1  # share of the images' unknowns: a border of this size costs less than the fill-in that it prevents


class Views(NamedTuple):
    """Views, which fill the slots of a tile: an image, and another view for repeated measurements of a point.

    `of_ray`: view of each ray; views are numbered by the rank of their image. `rank`, `centre`: of the image.
    """

    of_ray: Int[np.ndarray, " ray"]
    rank: Int[np.ndarray, " view"]
    centre: Float[np.ndarray, "view 3"]


def border_points(structure: Structure, groups: tuple[ObservationGroup, ...]) -> Bool[np.ndarray, " point"]:
    """Mask of points that are not eliminated: they share an observation, or elimination would be slower.

    Slower are points without rays, and a few points on very many images, which would fill the reduced matrix. Tiles of
    points with long tracks multiply pairs of slots in one order only, so an image must not have two slots.
    """
    count = np.bincount(structure.ray_point, minlength=len(structure.point_names))
    in_border, long = count == 0, count > SLOTS
    repeated = np.zeros(len(count), bool)
    repeated[structure.ray_point[structure.ray_repeat > 0]] = True
    in_border |= long & repeated
    if 3 * long.sum() <= BORDER_SHARE * 6 * len(structure.image_names):
        in_border |= long
    for group in groups:
        touches = group.structure.kind.touches
        for k, kind in enumerate(touches):
            if kind == "point" and len(touches) > 1:
                in_border[group.structure.indices[:, k]] = True
    return in_border


def own_cameras(structure: Structure) -> bool:
    """Whether each image has a separate camera, whose interior elements then belong to the image's block."""
    used = np.bincount(structure.image_camera, minlength=len(structure.cameras))
    return bool(structure.interior_columns) and bool((used == 1).all())


def group_image_pairs(structure: Structure, group: ObservationGroup, own: bool) -> Int[np.ndarray, "member 2"] | None:
    """The two touched images of each member, None if members touch only one."""
    camera_image = np.zeros(len(structure.cameras), int)
    camera_image[structure.image_camera] = np.arange(len(structure.image_camera))
    columns = []
    for k, kind in enumerate(group.structure.kind.touches):
        if kind == "image":
            columns.append(group.structure.indices[:, k])
        elif kind == "camera" and own:
            columns.append(camera_image[group.structure.indices[:, k]])
    if len(columns) > 2:
        raise ValueError(f"observations of kind {group.structure.kind.name} touch more than two images")
    return np.stack(columns, 1) if len(columns) == 2 else None


def views_of(
    rank: Int[np.ndarray, " ray"], repeat: Int[np.ndarray, " ray"], centres: Float[np.ndarray, "image 3"]
) -> Views:
    """The views of some rays by the ranks of their images; `centres` by rank."""
    most = int(repeat.max(initial=0)) + 1
    if most == 1:
        return Views(rank, np.arange(len(centres)), centres)
    views, of_ray = np.unique(rank * most + repeat, return_inverse=True)
    return Views(of_ray, views // most, centres[views // most])
