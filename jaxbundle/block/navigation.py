"""Navigation data: projection centres and attitudes observed in flight, with systematic errors (Text 003, R_i of 1.19).

    v = X0 + R l + s + s' t - X_observed              l: from projection centre to antenna, system of the photograph
    v = angles(R R_b) + a + a' t - angles_observed    R_b: from photograph to inertial unit, small angles b

Shift s, a and drift s', a' belong to a strip or to the whole block, lever arm l and boresight b to a mounted camera.
All are parameters of the block: unknown, fixed, or with a prior. t is time, or proportional to time.
"""

from jaxbundle.block.geodetic import wrapped
from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA, OMEGA_PHI_KAPPA, Rotation, RotationSystem


def _centre(image: tuple[Vector, Rotation], *numbers) -> Vector:
    lever, shift, drift, observed, (time,) = numbers[:3], numbers[3:6], numbers[6:9], numbers[9], numbers[10]
    antenna = rotation.apply(image[1], (lever[0], lever[1], lever[2]))
    x, y, z = (image[0][k] + antenna[k] + shift[k] + drift[k] * time - observed[k] for k in range(3))
    return x, y, z


def _angles(system: RotationSystem, image: tuple[Vector, Rotation], numbers: tuple) -> Vector:
    boresight, shift, drift, observed, (time,) = numbers[:3], numbers[3:6], numbers[6:9], numbers[9], numbers[10]
    unit = rotation.product(image[1], system.rotation_from_angles(boresight[0], boresight[1], boresight[2]))
    angles = system.angles_from_rotation(unit)
    x, y, z = (wrapped(angles[k] + shift[k] + drift[k] * time - observed[k]) for k in range(3))
    return x, y, z


def _omega_phi_kappa(image: tuple[Vector, Rotation], *numbers) -> Vector:
    return _angles(OMEGA_PHI_KAPPA, image, numbers)


def _alpha_omega_kappa(image: tuple[Vector, Rotation], *numbers) -> Vector:
    return _angles(ALPHA_OMEGA_KAPPA, image, numbers)


_TOUCHES = ("image", *["parameter"] * 9)
# these rows share one table with observed stations without systematic errors
GNSS_STATIONS = ObservationKind(
    "gnss_stations",
    ("X0", "Y0", "Z0"),
    _TOUCHES,
    _centre,
    in_object_system=True,
    constants=("time",),
    table="stations",
)
"""Observed projection centres with lever arm, shift and drift as parameters.

Example:
    >>> jb.observations.GNSS_STATIONS.table, jb.observations.GNSS_STATIONS.components
    ('stations', ('X0', 'Y0', 'Z0'))
"""
ATTITUDES = {
    system.name: ObservationKind("attitudes", system.angles, _TOUCHES, residual, constants=("time",), angles=True)
    for system, residual in ((OMEGA_PHI_KAPPA, _omega_phi_kappa), (ALPHA_OMEGA_KAPPA, _alpha_omega_kappa))
}
"""Observed attitudes of images by the name of the rotation system, with boresight, shift and drift as parameters.

Example:
    >>> jb.observations.ATTITUDES["omega-phi-kappa"].components
    ('omega', 'phi', 'kappa')
"""
