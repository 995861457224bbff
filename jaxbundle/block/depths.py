"""Depths of points: their distances in front of the cameras.

    p_z = (a3, b3, c3) . (X - X0),        R = [a; b; c] from the photograph to the object system

The camera looks along -z, so p_z < 0 in front of it. The collinearity equations do not depend on this sign: they are
valid for the whole line of a ray.
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of


def viewing_directions(block: Block) -> Float[np.ndarray, "image 3"]:
    """Unit vectors of the viewing directions of the cameras, object system."""
    return -np.asarray(unknowns_of(block).rotation).reshape(3, 3, -1)[:, 2].T


def depths(block: Block) -> Float[np.ndarray, " ray"]:
    """Depth of each ray's point along the camera axis, object unit; negative behind the camera."""
    structure = block.structure
    centres, points = np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)
    image = structure.ray_image
    return np.sum((points[structure.ray_point] - centres[image]) * viewing_directions(block)[image], 1)


def behind(block: Block) -> Bool[np.ndarray, " ray"]:
    """Indices of rays whose point is not in front of the camera; none for sensors other than photographs."""
    if not block.structure.model.photographs:
        return np.zeros(len(block.structure.ray_image), bool)
    return ~(depths(block) > 0)
