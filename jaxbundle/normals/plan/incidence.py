"""What the plan reads off who sees what: points of the border, images joined by an observation, what fills a slot."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.normals.plan.tiling import SLOTS

BORDER_SHARE = 0.1  # of the images' unknowns: so much of a border costs less than the matrix it keeps sparse


class Views(NamedTuple):
    """What fills a slot of a tile: an image, and once more for a point that was measured on it again.

    `of_ray`: view of each ray; views are numbered by the rank of their image. `rank`, `centre`: of their image.
    """

    of_ray: Int[np.ndarray, " ray"]
    rank: Int[np.ndarray, " view"]
    centre: Float[np.ndarray, "view 3"]


def border_points(structure: Structure, groups: tuple[ObservationGroup, ...]) -> Bool[np.ndarray, " point"]:
    """Points that cannot be eliminated one by one, since they share an observation, or better are not.

    The second are points without rays, and a few points on very many images, which would fill the reduced matrix. Tiles
    of points with long tracks multiply pairs of slots in one order only, which two slots of one image do not allow.
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
    """Whether every image has a camera of its own, whose interior then belongs to the image's block."""
    used = np.bincount(structure.image_camera, minlength=len(structure.cameras))
    return bool(structure.interior_columns) and bool((used == 1).all())


def group_image_pairs(structure: Structure, group: ObservationGroup, own: bool) -> Int[np.ndarray, "member 2"] | None:
    """The two images each member touches, None where it never touches two."""
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
