"""Undetermined small similarity transformations (t, r, m), described as position, rotations and scale."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

RANK_TOLERANCE = 1e-8  # tolerance of singular values, which are of order 1 for control spread over the block

Direction = tuple[float, float, float]


@dataclass(frozen=True)
class SimilarityDefect:
    """Which of the seven parameters of a similarity transformation are undetermined, and in which directions.

    `origin`: directions of the position; `axes`: directions of the axes of rotation, each with combinations of the
    position; `scale`: the scale, with combinations of the others.
    """

    origin: tuple[Direction, ...] = ()
    axes: tuple[Direction, ...] = ()
    scale: bool = False

    @property
    def count(self) -> int:
        """Number of undetermined parameters of the seven."""
        return len(self.origin) + len(self.axes) + self.scale

    @property
    def words(self) -> str:
        """The undetermined parameters in words."""
        if self.count == 7:
            return "origin, axes and scale"
        if len(self.origin) == 3:
            words = ["the origin"]
        else:
            words = [f"the position along {_axis(direction)}" for direction in self.origin]
        if len(self.axes) == 1:
            words.append(f"the rotation about an axis parallel to {_axis(self.axes[0])}")
        elif self.axes:
            words.append("all three rotations" if len(self.axes) == 3 else "two of the three rotations")
        return ", ".join([*words, *(["the scale"] if self.scale else [])])


def similarity_defect(free: Float[np.ndarray, "7 defect"]) -> SimilarityDefect:
    """Undetermined combinations of the seven parameters (orthonormal columns), sorted."""
    if free.shape[1] == 0:
        return SimilarityDefect()
    shifts = free @ null_space_of(free[3:])  # combinations without rotation and scale
    rest = free - shifts @ (shifts.T @ free)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    remaining = left[:, size > RANK_TOLERANCE]
    turns, size, _ = np.linalg.svd(remaining[3:6], full_matrices=False)
    turns = turns[:, : int((size > RANK_TOLERANCE).sum())]
    return SimilarityDefect(_directions(shifts[:3]), _directions(turns), remaining.shape[1] > turns.shape[1])


def _directions(columns: Float[np.ndarray, "3 k"]) -> tuple[Direction, ...]:
    """Unit vectors that span the same space, independent of the basis: the largest coordinate axes first."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    left = left[:, size > RANK_TOLERANCE]
    projector, found = left @ left.T, []
    for _ in range(left.shape[1]):
        k = int(np.argmax(np.round(np.diagonal(projector), 6)))
        direction = projector[:, k] / np.linalg.norm(projector[:, k])
        found.append(tuple((np.round(direction, 6) + 0.0).tolist()))
        projector = projector - np.outer(direction, direction)
    return tuple(found)


def null_space_of(matrix: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "column defect"]:
    """Orthonormal directions of the null space of the rows."""
    columns = matrix.shape[1]
    _, singular, vt = np.linalg.svd(np.concatenate([matrix, np.zeros((columns, columns))]), full_matrices=False)
    return vt[singular <= RANK_TOLERANCE].T


def displacements(
    datum: Float[np.ndarray, "7 defect"], places: Float[np.ndarray, "place 3"], radius: float
) -> Float[np.ndarray, "defect place 3"]:
    """Displacements of positions, relative to the centre of the block, under similarity transformations."""
    t, r, m = datum[:3].T[:, None], datum[3:6].T[:, None], datum[6][:, None, None]
    return t * radius + np.cross(r, places) + m * places


def _axis(direction: Direction) -> str:
    unit = np.array(direction) / np.linalg.norm(direction)
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) > 0.999:
        return "XYZ"[k]
    return "({:.2f}, {:.2f}, {:.2f})".format(*np.round(unit * np.sign(unit[k]), 2) + 0.0)
