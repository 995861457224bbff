"""Vectors of all unknowns in the order of elimination: images, border, eliminated points."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Structure
from jaxbundle.normals.arrange import Arrangement


class NormalVector(NamedTuple):
    """A vector of all unknowns in the order of elimination, or several with a leading axis; 0 where one is held."""

    images: Float[Array, "*vector image d"]
    border: Float[Array, "*vector border"]
    tiles: Float[Array, "*vector 3 tile column"]


def arranged_vectors(
    plan: Arrangement,
    structure: Structure,
    exterior: Float[np.ndarray, "vector image 6"],
    interior: Float[np.ndarray, "vector camera column"],
    parameters: Float[np.ndarray, "vector parameter"],
    object_points: Float[np.ndarray, "vector point 3"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of a `NormalVector` by the elements of the block, angles those of the corrections; 0 for what is held."""
    o, shape, count = plan.order, plan.shape, len(exterior)
    interior = interior * structure.interior_free[:, list(structure.interior_columns)]
    images, border = np.zeros((count, o.images, shape.image)), np.zeros((count, shape.border))
    images[:, o.image, :6] = exterior * structure.exterior_free
    if shape.image > 6:
        images[:, o.camera, 6:] = interior
    else:
        border[:, : shape.first_parameter] = interior.reshape(count, -1)
    inside = slice(shape.first_parameter, shape.first_parameter + o.parameters)
    border[:, inside] = parameters * structure.parameter_free
    points = np.zeros((count, 3, o.points))
    points[:, :, o.point] = (object_points * structure.point_free).transpose(0, 2, 1)
    border[:, shape.first_kept_point :] = points[:, :, plan.places :].transpose(0, 2, 1).reshape(count, -1)
    tiles = points[:, :, : plan.places].reshape(count, 3, -1, shape.width)
    return images, border, tiles
