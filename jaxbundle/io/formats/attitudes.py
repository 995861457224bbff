"""Conversion of attitudes in flight to photogrammetric angles, and back.

    R = E R_z(yaw) R_y(pitch) R_x(roll) B D,    E = [[0,1,0],[1,0,0],[0,0,-1]],  B = [[0,0,1],[1,0,0],[0,1,0]]

R transforms from the axes of a camera on a gimbal (yaw clockwise from north; pitch 0 is level, -90 looks down).
E transforms from north-east-down to east-north-up, B from the camera axes of computer vision, D = diag(1, -1, -1). In a
grid the meridian convergence is subtracted from the yaw. OpenDroneMap and Metashape count pitch from the nadir: pitch
of the gimbal = pitch - 90.
"""

import math

import numpy as np
from jaxtyping import Float

from jaxbundle.geometry.rotation import Rotation, Scalar, about_x, about_y, about_z, product
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.coordinates import convergence, is_metric_local
from jaxbundle.io.formats.foreign_block import Known, triple

_E = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
_B = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


def _yaw_pitch_roll(yaw: Scalar, pitch: Scalar, roll: Scalar) -> Rotation:
    return product(product(about_z(yaw), about_y(pitch)), about_x(roll))


def rotations_of_gimbal(degrees: Float[np.ndarray, "image 3"]) -> Float[np.ndarray, "image 3 3"]:
    """Rotation object_from_image of yaw, pitch and roll of a gimbal in degrees; object system east, north, up.

    Example: (0, -90, 0) looks down, with the top of the image to the north: omega, phi, kappa are 0.
    """
    turned = rotations.matrices(_yaw_pitch_roll, np.radians(np.asarray(degrees, float)))
    return _E @ turned @ _B @ rotations.DOWN_FORWARD


def observed_attitudes(
    attitudes: tuple[Known, ...], stations: tuple[Known, ...], system: str, sigma: float
) -> tuple[Known, ...]:
    """Observations of omega, phi, kappa in radians, with one standard deviation.

    Args:
        attitudes: yaw from true north, pitch and roll in degrees, for each image.
        stations: positions of the same images in the system of the block.
        system: text of that system; for a projected system the meridian convergence is subtracted from the yaw.
        sigma: of each angle, in degrees.
    """
    places = {row.name: row.coordinates for row in stations}
    rows = [row for row in attitudes if row.name in places and np.isfinite(row.coordinates).all()]
    if not rows:
        return ()
    degrees = np.array([row.coordinates for row in rows])
    if system and not is_metric_local(system):
        degrees[:, 0] -= np.degrees(convergence(system, np.array([places[row.name] for row in rows])))
    angles = rotations.to_angles(rotations_of_gimbal(degrees))
    sigmas = (math.radians(sigma), math.radians(sigma), math.radians(sigma))
    return tuple(Known(row.name, triple(angle), sigmas) for row, angle in zip(rows, angles.tolist(), strict=True))
