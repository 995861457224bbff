"""Static sizes of the normal equations, and positions of unknowns in the border.

image's block    X0 Y0 Z0, three angles, then the interior elements of a camera with only this image
border           interior elements of shared cameras | parameters | border points, 3 coordinates each
"""

from typing import Any, NamedTuple

import numpy as np

EXTERIOR = 6  # number of exterior elements: X0, Y0, Z0 and three angles


class Layout(NamedTuple):
    """Static sizes of a program; numbers of images, points and rays are padded and follow from the arrays."""

    image: int
    """Number of unknowns of an image."""
    shared: int
    """Number of estimated interior elements of a shared camera, 0 if each image has its own."""
    cameras: int
    """Number of shared cameras."""
    parameters: int
    """Parameters, padded."""
    points: int
    """Padded number of border points, which are not eliminated."""
    pairs: int
    """Padded number of blocks of image pairs; the last one is a dummy."""
    implicit: bool
    """Whether the reduced matrix is not formed: then its pairs are only the diagonal blocks."""
    width: int
    """Points per tile."""

    @property
    def own_cameras(self) -> bool:
        """Whether the interior elements are in the images' blocks."""
        return self.image > EXTERIOR

    @property
    def first_parameter(self) -> int:
        """Number of border rows before the parameters."""
        return self.shared * self.cameras

    @property
    def first_point(self) -> int:
        """Number of border rows before the border points."""
        return self.first_parameter + self.parameters

    @property
    def border(self) -> int:
        """Total number of border rows."""
        return self.first_point + 3 * self.points

    def camera_rows(self, camera: Any) -> Any:
        """Border rows of shared cameras: (..., element)."""
        return _consecutive(self.shared * camera, self.shared)

    def point_rows(self, point: Any) -> Any:
        """Border rows of border points, with indices relative to the first of them: (..., 3)."""
        return self.first_point + _consecutive(3 * point, 3)


def _consecutive(first: Any, count: int) -> Any:
    """`count` consecutive integers from each of an array of first ones, along a new last axis."""
    return first[..., None] + np.arange(count, dtype=first.dtype).reshape((1,) * first.ndim + (count,))
