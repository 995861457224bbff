"""Approximate values from approximate coordinates: orientations of sets of directions, planes and lines.

A plane or line is described in a fixed frame (block/geodetic.py) at the centre of gravity of its points. The third axis
is the normal of the plane, the right singular vector of the minimum singular value of the centred coordinates, or the
direction of the line, that of the maximum. In this frame all parameters are 0.

The sign of a singular vector is undefined, and also its direction for equal singular values: both would depend on the
order of the rows. So the third axis points up (to +Y where it is horizontal, to +X where it is parallel to X), and the
first one is the projection of the coordinate axis that is farthest from the third.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import LINES, PLANES, geodetic_kind
from jaxbundle.block.problems import Problem
from jaxbundle.numerics.host import tree_with

DEGENERATE = 1e-6  # ratio of the extents across and along: points on a line, or at one position
SENSE = 1e-6  # components of unit vectors that differ by less are equal; far above rounding
DIRECTIONS = tuple(
    geodetic_kind("directions", start, end) for start in ("point", "image") for end in ("point", "image")
)


def with_planes_and_lines(block: Block) -> tuple[Block, list[Problem]]:
    """The block with parameters and frames for those that are NaN, and problems of degenerate planes and lines."""
    values = np.array(block.parameters)
    constants = [np.array(group.constants) for group in block.groups]
    problems = []
    for group, frames in zip(block.groups, constants, strict=True):
        kind, indices = group.structure.kind, group.structure.indices
        if kind in DIRECTIONS:
            unknown, first = np.unique(indices[:, 2], return_index=True)
            azimuths = _azimuths(block, kind.touches, indices[first]) - np.asarray(group.values)[first, 0]
            values[unknown] = np.where(np.isnan(values[unknown]), azimuths % (2 * np.pi), values[unknown])
        elif kind in (PLANES, LINES):
            for members in _figures(indices, np.flatnonzero(np.isnan(frames[:, 0]))):
                points = np.asarray(block.object_points)[indices[members, 0]]
                frame = _frame(points, kind == PLANES) if np.isfinite(points).all() else None
                frames[members] = np.concatenate([points.mean(0), np.eye(3).ravel()]) if frame is None else frame
                values[indices[members[0], 1:]] = 0.0
                if frame is None and np.isfinite(points).all():
                    problems.append(_no_figure(block, kind == PLANES, int(members[0]), indices[members[0]]))
    groups = tuple(
        tree_with(lambda g: g.constants, group, frames) for group, frames in zip(block.groups, constants, strict=True)
    )
    return tree_with(lambda b: (b.parameters, b.groups), block, (values, groups)), problems


def _azimuths(block: Block, touches: tuple[str, ...], indices: Int[np.ndarray, "row 3"]) -> Float[np.ndarray, " row"]:
    positions = {"point": np.asarray(block.object_points), "image": np.asarray(block.exterior.projection_centre)}
    start, end = (positions[touches[k]][indices[:, k]] for k in range(2))
    return np.arctan2(end[:, 0] - start[:, 0], end[:, 1] - start[:, 1])


def _figures(
    indices: Int[np.ndarray, "member touched"], wanted: Int[np.ndarray, " row"]
) -> Iterator[Int[np.ndarray, " _member"]]:
    """The members of each plane or line with a requested row."""
    for parameters in np.unique(indices[wanted, 1:], axis=0):
        yield np.flatnonzero((indices[:, 1:] == parameters).all(1))


def _frame(points: Float[np.ndarray, "point 3"], plane: bool) -> Float[np.ndarray, "12"] | None:
    """Origin and axes; None if the points do not determine the plane or line."""
    origin = points.mean(0)
    _, extent, axes = np.linalg.svd(points - origin)
    size = np.append(extent, 0.0)
    # coordinates have rounding errors proportional to their size
    least = max(DEGENERATE * size[0], 1e3 * np.finfo(float).eps * np.abs(points).max())
    if (size[1] if plane else size[0]) <= least:
        return None
    third = _upward(axes[2] if plane else axes[0])
    along = np.abs(third)
    farthest = int(np.argmax(along <= along.min() + SENSE))
    first = np.eye(3)[farthest] - third[farthest] * third
    first /= np.linalg.norm(first)
    return np.concatenate([origin, np.stack([first, np.cross(third, first), third], 1).ravel()])


def _upward(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The direction or its opposite, by the last of its components that is not 0."""
    last = np.flatnonzero(np.abs(direction) > SENSE)[-1]
    return direction * np.sign(direction[last])


def _no_figure(block: Block, plane: bool, row: int, indices: np.ndarray) -> Problem:
    parameter = block.structure.parameters[indices[1]]
    name = parameter.owner.words if parameter.owner else parameter.name
    where = "lie on one line" if plane else "coincide"
    cure = f"name points that are spread over the {'plane' if plane else 'line'}, or correct their coordinates"
    return Problem(f"{name}: its points {where}", cure, "planes" if plane else "lines", row)
