"""Converting the rotations of many images between formats and matrices, with the functions of geometry/rotation.py.

    D = diag(1, -1, -1)        R_jb = R^T D,  X0 = -R^T t        back: R = D R_jb^T,  t = -R X0

(R, t) transform from the object system to a camera of computer vision (x right, y down, z forward). Arrays are
padded, so that blocks of all sizes use few compiled programs.
"""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.geometry.rotation import (
    OMEGA_PHI_KAPPA,
    Rotation,
    about_x,
    about_y,
    about_z,
    from_quaternion,
    from_rotation_vector,
    product,
    to_quaternion,
    to_rotation_vector,
)
from jaxbundle.numerics.shapes import grid_size

DOWN_FORWARD = np.diag([1.0, -1.0, -1.0])  # D
Matrices = Float[np.ndarray, "image 3 3"]


def phi_omega_kappa(phi: Array, omega: Array, kappa: Array) -> Rotation:
    """The rotation matrix R_y(phi) R_x(omega) R_z(kappa)."""
    return product(product(about_y(phi), about_x(omega)), about_z(kappa))


@cache
def _program(function: Callable, columns: int) -> Callable:
    return jax.jit(lambda rows: jnp.stack(jnp.broadcast_arrays(*function(*(rows[:, k] for k in range(columns)))), -1))


@cache
def _inverse_program(function: Callable) -> Callable:
    return jax.jit(lambda rows: jnp.stack(function(tuple(rows[:, k] for k in range(9))), -1))


def _padded(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows, np.ones((grid_size(len(rows)) - len(rows), rows.shape[1]))])


def matrices(function: Callable[..., Rotation], rows: Float[np.ndarray, "image number"]) -> Matrices:
    """Matrices of angles (radians), rotation vectors or quaternions, computed by a function of scalars."""
    rows = np.asarray(rows, float)
    return np.asarray(_program(function, rows.shape[1])(_padded(rows)))[: len(rows)].reshape(-1, 3, 3)


def numbers(function: Callable[[Rotation], tuple], rotations: Matrices) -> Float[np.ndarray, "image number"]:
    """Angles, rotation vectors or quaternions of matrices, computed by a function of nine scalars."""
    rows = np.asarray(rotations, float).reshape(-1, 9)
    return np.asarray(_inverse_program(function)(_padded(rows)))[: len(rows)]


def from_quaternions(rows: Float[np.ndarray, "image 4"]) -> Matrices:
    """Matrices of quaternions, scalar part first; NaN for a quaternion 0."""
    with np.errstate(all="ignore"):
        return np.stack(from_quaternion(*np.asarray(rows, float).T), -1).reshape(-1, 3, 3)


def to_quaternions(rotations: Matrices) -> Float[np.ndarray, "image 4"]:
    """Unit quaternions, scalar part first and not negative."""
    return numbers(to_quaternion, rotations)


def from_vectors(rows: Float[np.ndarray, "image 3"]) -> Matrices:
    """Matrices of rotation vectors (Rodrigues)."""
    return matrices(from_rotation_vector, rows)


def to_vectors(rotations: Matrices) -> Float[np.ndarray, "image 3"]:
    """Rotation vectors of matrices (Rodrigues)."""
    return numbers(to_rotation_vector, rotations)


def from_angles(rows: Float[np.ndarray, "image 3"]) -> Matrices:
    """Matrices of omega, phi, kappa in radians."""
    return matrices(OMEGA_PHI_KAPPA.rotation_from_angles, rows)


def to_angles(rotations: Matrices) -> Float[np.ndarray, "image 3"]:
    """Angles omega, phi, kappa of matrices, in radians."""
    return numbers(OMEGA_PHI_KAPPA.angles_from_rotation, rotations)


def from_camera(
    rotation: Matrices, translation: Float[np.ndarray, "image 3"]
) -> tuple[Matrices, Float[np.ndarray, "image 3"]]:
    """Converts R, t of computer vision to (R_jb, X0)."""
    back = np.swapaxes(rotation, 1, 2)
    return back @ DOWN_FORWARD, -(back @ translation[:, :, None])[:, :, 0]


def to_camera(
    rotation: Matrices, centre: Float[np.ndarray, "image 3"]
) -> tuple[Matrices, Float[np.ndarray, "image 3"]]:
    """Converts R_jb, X0 to (R, t) of computer vision."""
    turned = DOWN_FORWARD @ np.swapaxes(rotation, 1, 2)
    return turned, -(turned @ centre[:, :, None])[:, :, 0]


def orthogonal(rotation: Matrices) -> Matrices:
    """The nearest rotations to matrices printed with rounding (polar decomposition)."""
    u, _, vt = np.linalg.svd(rotation)
    return u @ vt
