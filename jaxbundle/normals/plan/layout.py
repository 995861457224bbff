"""Static sizes of the normal equations, and where an unknown stands in the border.

image's block    X0 Y0 Z0, three angles, then the interior elements of a camera that only this image has
border           interior elements of shared cameras | parameters | border points, 3 coordinates each
"""

from typing import Any, NamedTuple

import numpy as np

EXTERIOR = 6  # X0, Y0, Z0 and three angles


class Layout(NamedTuple):
    """Sizes that are static in a program; numbers of images, points and rays are padded and stand in the arrays."""

    image: int
    """Unknowns of an image."""
    shared: int
    """Estimated interior elements of a shared camera, 0 where every image has its own."""
    cameras: int
    """Shared cameras."""
    parameters: int
    """Parameters, padded."""
    points: int
    """Border points, padded: those that are not eliminated."""
    pairs: int
    """Blocks of image pairs, padded; the last one takes what belongs nowhere."""
    implicit: bool
    """The reduced matrix is not formed: its pairs are the images with themselves."""
    width: int
    """Points per tile."""

    @property
    def own_cameras(self) -> bool:
        """Whether the interior elements stand in the images' blocks."""
        return self.image > EXTERIOR

    @property
    def first_parameter(self) -> int:
        """Border rows before the parameters."""
        return self.shared * self.cameras

    @property
    def first_point(self) -> int:
        """Border rows before the border points."""
        return self.first_parameter + self.parameters

    @property
    def border(self) -> int:
        """Border rows."""
        return self.first_point + 3 * self.points

    def camera_rows(self, camera: Any) -> Any:
        """Border rows of shared cameras: (..., element)."""
        return self.shared * camera[..., None] + np.arange(self.shared)

    def point_rows(self, point: Any) -> Any:
        """Border rows of border points, counted from the first of them: (..., 3)."""
        return self.first_point + 3 * point[..., None] + np.arange(3)
