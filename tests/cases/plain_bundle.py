"""A bundle adjustment of a camera without distortion in plain numpy: a witness that shares nothing with the package.

Rays of standard deviation 1 alone, all orientations and points free: what the rays do not determine, the seven
parameters of a similarity, is held by the damping.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

MAX_STEPS = 400  # along the weak directions of a single strip sixty are too few
SETTLED = 1e-12  # relative change of the sum of squares
MIN_DAMPING = 1e-10  # with less, rounding makes the equations singular


class Bundle(NamedTuple):
    """Rotations object_from_image, centres, points, and the sum of squared residuals in px^2."""

    rotation: np.ndarray
    centre: np.ndarray
    points: np.ndarray
    squares: float


def adjusted(
    start: tuple[np.ndarray, np.ndarray, np.ndarray], image: np.ndarray, point: np.ndarray, xy: np.ndarray, c: float
) -> Bundle:
    """The minimum that is reached from a start: rotations, centres, points."""
    rotation, centre, points = start
    damping, (v, p) = 1e-4, _residuals(start, image, point, xy, c)
    squares = float((v**2).sum())
    for _ in range(MAX_STEPS):
        images, of_points = _step(rotation, (v, p), (image, point), (len(centre), len(points)), (c, damping))
        turn = Rotation.from_rotvec(images[:, :3]).as_matrix()
        new = rotation @ turn, centre + images[:, 3:], points + of_points
        v_new, p_new = _residuals(new, image, point, xy, c)
        total = float((v_new**2).sum())
        if total < squares:
            settled = squares - total < SETTLED * squares
            (rotation, centre, points), v, p, squares, damping = (
                new,
                v_new,
                p_new,
                total,
                max(damping / 10, MIN_DAMPING),
            )
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return Bundle(rotation, centre, points, squares)


def _residuals(at: tuple, image: np.ndarray, point: np.ndarray, xy: np.ndarray, c: float) -> tuple:
    rotation, centre, points = at
    p = np.einsum("rji,rj->ri", rotation[image], points[point] - centre[image])
    return -c * p[:, :2] / p[:, 2:] - xy, p


def _step(rotation: np.ndarray, at: tuple, of: tuple, sizes: tuple, constants: tuple) -> tuple:
    """Corrections: a small rotation of each image about its own axes and its centre; and the points."""
    (v, p), (image, point), (images, points), (c, damping) = at, of, sizes, constants
    by_p = np.zeros((len(v), 2, 3))
    by_p[:, 0, 0] = by_p[:, 1, 1] = -c / p[:, 2]
    by_p[:, :, 2] = c * p[:, :2] / p[:, 2:] ** 2
    x, y, z = p.T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)  # p -> p + [p]x w for R Exp(w)
    b = np.einsum("rij,rkj->rik", by_p, rotation[image])
    a = np.concatenate([by_p @ skew, -b], 2)
    n = _summed(np.einsum("rki,rkj->rij", b, b), point, points)
    u = _summed(np.einsum("rki,rkj->rij", a, a), image, images)
    for block in (n, u):
        k = np.arange(block.shape[1])
        block[:, k, k] *= 1 + damping
    inverse = np.linalg.inv(n + 1e-14 * np.trace(n, axis1=1, axis2=2)[:, None, None] * np.eye(3))
    w = np.einsum("rki,rkj->rij", a, b)
    g_point = _summed(np.einsum("rki,rk->ri", b, v), point, points)
    g_image = _summed(np.einsum("rki,rk->ri", a, v), image, images)
    dense = np.zeros((6 * images, 3 * points))
    rows, columns = 6 * image[:, None, None] + np.arange(6)[:, None], 3 * point[:, None, None] + np.arange(3)
    np.add.at(dense, (rows, columns), w)
    scaled = np.einsum("apj,pjk->apk", dense.reshape(6 * images, points, 3), inverse).reshape(dense.shape)
    reduced = -scaled @ dense.T
    for i in range(images):
        reduced[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += u[i]
    without_rays = np.flatnonzero(np.diagonal(reduced) == 0)
    reduced[without_rays, without_rays] = 1.0
    of_images = -np.linalg.solve(reduced, g_image.ravel() - scaled @ g_point.ravel())
    rest = g_point + (dense.T @ of_images).reshape(points, 3)
    return of_images.reshape(images, 6), -np.einsum("pij,pj->pi", inverse, rest)


def _summed(values: np.ndarray, of: np.ndarray, count: int) -> np.ndarray:
    total = np.zeros((count, *values.shape[1:]))
    np.add.at(total, of, values)
    return total
