"""The block in plan view: stations, outlines of the images, object points and their role."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.report.figures import Figures
from jaxbundle.report.pictures.known import known

TIE, CONTROL_POINT, CHECK_POINT = range(3)
DIRECTIONS = 12  # maximum number of corners of an outline


class Plan(NamedTuple):
    """Adjusted positions in the object system.

    `role`: tie, control or check for each point; `outlines`: for each image the corners X, Y of the area of its
    measured points.
    """

    stations: Float[np.ndarray, "image 3"]
    points: Float[np.ndarray, "point 3"]
    role: Int[np.ndarray, " point"]
    outlines: tuple[Float[np.ndarray, "_corner 2"], ...]


def plan(figures: Figures) -> Plan:
    """The plan of the block, from the numbers of an adjustment."""
    points = known(figures.points)
    role = np.zeros(len(points), np.int8)
    role[figures.control_point] = CONTROL_POINT
    role[figures.structure.check_point] = CHECK_POINT
    return Plan(known(figures.exterior[:, :3]), points, role, _outlines(figures, points))


def _outlines(figures: Figures, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Outline of each image: its points that lie farthest in some directions, in their order around the image."""
    structure = figures.structure
    usable = np.isfinite(points[structure.ray_point, :2]).all(1)
    image, point = structure.ray_image[usable], structure.ray_point[usable]
    order = np.argsort(image, kind="stable")
    seen = points[point[order], :2]
    ends = np.cumsum(np.bincount(image, minlength=len(structure.image_names))).tolist()
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = np.stack([np.cos(angles), np.sin(angles)])
    outlines = []
    for first, end in zip([0, *ends], ends, strict=False):
        mine = seen[first:end]
        corners = mine[(mine @ directions).argmax(0)] if end > first else mine
        outlines.append(corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1)])
    return tuple(outlines)
