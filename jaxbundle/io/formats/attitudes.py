"""Attitudes in flight as photogrammetric angles, and back.

    R = E R_z(yaw) R_y(pitch) R_x(roll) B D,    E = [[0,1,0],[1,0,0],[0,0,-1]],  B = [[0,0,1],[1,0,0],[0,1,0]]

from the axes of a camera on a gimbal (yaw clockwise from north, pitch 0 is level and -90 looks down), E from
north-east-down to east-north-up, B from the camera of computer vision, D = diag(1, -1, -1). In a grid the meridian
convergence is subtracted from the yaw. OpenDroneMap and Metashape count pitch from the nadir: pitch of the gimbal =
pitch - 90.
"""

import numpy as np
from jaxtyping import Float

from jaxbundle.geometry.rotation import Rotation, about_x, about_y, about_z, product
from jaxbundle.io.formats import rotations

_E = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
_B = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


def _yaw_pitch_roll(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> Rotation:
    return product(product(about_z(yaw), about_y(pitch)), about_x(roll))


def rotations_of_gimbal(degrees: Float[np.ndarray, "image 3"]) -> Float[np.ndarray, "image 3 3"]:
    """object_from_image, object system east, north, up, of yaw, pitch and roll of a gimbal in degrees.

    Example: (0, -90, 0) looks down, with the top of the image to the north: omega, phi, kappa are 0.
    """
    turned = rotations.matrices(_yaw_pitch_roll, np.radians(np.asarray(degrees, float)))
    return _E @ turned @ _B @ rotations.DOWN_FORWARD
