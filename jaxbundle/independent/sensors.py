"""Independent models and strips as sensors that measure points in three coordinates.

A model has an exterior orientation, its scale t as an interior element, and measured coordinates x, followed by the
factor L^-1 of their covariance L L^T:

    v = L^-1 (t R^T (X - X0) - x)                      7 unknowns, 3 residuals per point (Ackermann, Ebner, Klein 1973)

If the common errors e of all points of a model are estimated, their derivatives C follow the factor:

    v = L^-1 (t R^T (X - X0) - x - C e)                and e is observed as 0 with the standard deviation 1
"""

import numpy as np
from jaxtyping import Float

from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import Scalar

FACTOR = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))  # rows and columns of the elements of L^-1 in their order
SHARED = tuple(f"e{k + 1}" for k in range(5))


def whitened(v: Vector, factor: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """The weighted residuals L^-1 v."""
    f11, f21, f22, f31, f32, f33 = factor
    return f11 * v[0], f21 * v[0] + f22 * v[1], f31 * v[0] + f32 * v[1] + f33 * v[2]


def _model(interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    scale = interior[0]
    v = scale * p[0] - measured[0], scale * p[1] - measured[1], scale * p[2] - measured[2]
    return whitened(v, measured[3:9])


def _model_with_errors(interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    scale, *e = interior
    x, y, z = (scale * p[k] - measured[k] - sum(measured[9 + 5 * k + j] * e[j] for j in range(5)) for k in range(3))
    return whitened((x, y, z), measured[3:9])


MODEL = CameraModel("independent model", ("scale",), _model, components=3, numbers=9)
MODEL_WITH_ERRORS = CameraModel(
    "independent model with shared errors", ("scale", *SHARED), _model_with_errors, components=3, numbers=24
)


def factor_numbers(covariances: Float[np.ndarray, "ray 3 3"]) -> Float[np.ndarray, "ray 6"]:
    """The elements of L^-1 for each covariance L L^T."""
    inverse = np.linalg.inv(np.linalg.cholesky(covariances))  # number of elements of a triangle of three rows
    return np.stack([inverse[:, i, j] for i, j in FACTOR], 1)


def unwhitened(v: Float[np.ndarray, "ray 3"], numbers: Float[np.ndarray, "ray 6"]) -> Float[np.ndarray, "ray 3"]:
    """Residuals L v in the unit of the measured coordinates."""
    return np.linalg.solve(lower_triangles(numbers), v[..., None])[..., 0]


def lower_triangles(numbers: Float[np.ndarray, "ray 6"]) -> Float[np.ndarray, "ray 3 3"]:
    """The matrix L^-1 from its elements."""
    factor = np.zeros((len(numbers), 3, 3))
    for k, (i, j) in enumerate(FACTOR):
        factor[:, i, j] = numbers[:, k]
    return factor
