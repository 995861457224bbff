"""A second opinion: the covariance of vertical photographs over flat ground by closed partials and dense matrices.

dx = -dX + x/c dZ + ... per scale 1, angles in units of sigma0 / c;   result in sigma0 times the scale number
"""

import numpy as np
import scipy.linalg

from jaxbundle.block.block import Block
from jaxbundle.block.navigation import GNSS_STATIONS
from jaxbundle.block.observation_kinds import STATIONS

FIXED = 1e12  # weight of a fixed coordinate


def dense_deviations(block: Block, unit: float) -> np.ndarray:
    """Standard deviations of all points of a block of vertical photographs, in `unit`, sigma0 m."""
    s, c = block.structure, float(block.interior.elements[0, 0])
    centres, points = np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)
    kappa = np.asarray(block.exterior.angles)[:, 2]
    scale = (centres[0, 2] - points[0, 2]) / c
    images, count = len(centres), len(points)
    i, j = s.ray_image, s.ray_point
    cos, sin = np.cos(kappa)[i], np.sin(kappa)[i]
    off = (points[j, :2] - centres[i, :2]) / scale
    x, y = cos * off[:, 0] + sin * off[:, 1], cos * off[:, 1] - sin * off[:, 0]
    by_point = np.zeros((len(i), 2, 3))
    by_point[:, 0, :2], by_point[:, 1, :2] = np.c_[cos, sin], np.c_[-sin, cos]
    by_point[:, 0, 2], by_point[:, 1, 2] = x / c, y / c
    turned = np.stack([np.c_[-x * y, c * c + x * x, c * y], np.c_[-(c * c) - y * y, x * y, -c * x]], 1) / c**2
    by_image = np.concatenate([-by_point, turned], 2)
    parameters = len(s.parameters)
    normal = np.zeros((6 * images + parameters,) * 2)
    for image in range(images):
        rows = by_image[i == image].reshape(-1, 6)
        normal[6 * image : 6 * image + 6, 6 * image : 6 * image + 6] = rows.T @ rows
    for group in block.groups:
        _navigation(normal, group, images, unit)
    own = np.zeros((count, 3, 3))
    np.add.at(own, j, np.einsum("rki,rkl->ril", by_point, by_point))
    own[:, range(3), range(3)] += np.where(s.point_free, 0.0, FIXED)
    inverse = np.linalg.inv(own)
    mixed = np.einsum("rki,rkl->ril", by_image, by_point)
    members = [np.flatnonzero(j == k) for k in range(count)]
    for k, rays in enumerate(members):
        at, w = _rows(i[rays]), mixed[rays].reshape(-1, 3)
        normal[np.ix_(at, at)] -= w @ inverse[k] @ w.T
    free = normal.diagonal() != 0
    q = np.zeros_like(normal)
    q[np.ix_(free, free)] = scipy.linalg.inv(normal[np.ix_(free, free)])
    found = np.zeros((count, 3))
    for k, rays in enumerate(members):
        at, g = _rows(i[rays]), mixed[rays].reshape(-1, 3) @ inverse[k]
        found[k] = np.sqrt(np.diag(inverse[k] + g.T @ q[np.ix_(at, at)] @ g))
    return found


def _rows(images: np.ndarray) -> np.ndarray:
    return (6 * images[:, None] + np.arange(6)).ravel()


def _navigation(normal: np.ndarray, group, images: int, unit: float) -> None:
    """Observed centres, with shift and drift where they have them."""
    kind = group.structure.kind
    if kind not in (STATIONS, GNSS_STATIONS):
        return
    for row, sigmas, constants in zip(group.structure.indices, group.sigmas, group.constants, strict=True):
        for axis in range(3):
            at, values = [6 * row[0] + axis], [1.0]
            if kind == GNSS_STATIONS:
                at += [6 * images + row[4 + axis], 6 * images + row[7 + axis]]
                values += [1.0, float(constants[0])]
            normal[np.ix_(at, at)] += np.outer(values, values) * (unit / float(sigmas[axis])) ** 2
