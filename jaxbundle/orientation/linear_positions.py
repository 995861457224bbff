"""Positions of images and points from rays with known directions in space: one linear problem.

    sum w_ip |(I - g g^T)(X_p - C_i)|^2 = min,        g = A_i^T d_ip,        w_ip = rho_ip / (sigma_ip distance_ip)^2

The points are eliminated, as in the adjustment. Three directions of the reduced matrix S are shifts. The eigenvector of
the smallest other eigenvalue has the positions, up to the scale. The second smallest eigenvalue shows how well they are
determined: if it is similar, a part has an undetermined scale. The distances are updated in each pass, and rays that do
not fit lose their weight (rho).

A part of the block that few points connect to the rest may shrink to one place, where its own rays intersect without
misfit. The lengths of the bases, which the angles between the rays of a point give roughly, show it. Then the problem
is solved again with weak observations of these lengths: b_ij (C_j - C_i) = parallax_ij.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

PASSES = 4
ITERATIONS = 12  # steps of the inverse iteration
VECTORS = 3
RIDGE = 1e-11  # share of the mean diagonal
NEAR = 0.1  # minimum share of the median distance: a point at a camera would have more weight than all others
FIT = 4.0  # standard deviations for half of the weight of a ray
NARROW = 9.0  # in squared standard deviations of a direction
BEHIND = 1e-4  # weight of a ray to a point behind its image
RAYS = 60  # rays per image: more do not improve a start
CLEAR = 0.02  # rad: a smaller angle between rays may be the noise of a pair without base
SHRUNK = 0.1  # length of a base over that by its angle; depths of a block differ by less
PRIOR = 1e-3  # of the mean diagonal: weight of a length that is observed by its angle


class Positions(NamedTuple):
    """Projection centres in units of the block; `eigenvalues`: the two smallest ones without the shifts."""

    centre: Float[np.ndarray, "image 3"]
    eigenvalues: Float[np.ndarray, "2"]
    in_front: float
    """Share of the rays with points in front of their images."""
    sine: Float[np.ndarray, " ray"]
    """Sines of the angles between rays and their points."""


class Lines(NamedTuple):
    """Rays with directions in space; indices of images and points have no gaps."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    along: Float[np.ndarray, "ray 3"]
    sigma: Float[np.ndarray, " ray"]
    weight: Float[np.ndarray, " ray"]
    """Prior weight of the ray between 0 and 1."""
    images: int
    points: int


class Bases(NamedTuple):
    """Directions and parallaxes of the bases of pairs of images.

    `along`: unit vectors in space from the first image to the second. `parallax`: median angle between the rays of a
    point.
    """

    pair: Int[np.ndarray, "pair 2"]
    along: Float[np.ndarray, "pair 3"]
    parallax: Float[np.ndarray, " pair"]


def chosen_points(
    image: Int[np.ndarray, " ray"], point: Int[np.ndarray, " ray"], weight: Float[np.ndarray, " ray"], points: int
) -> Int[np.ndarray, " chosen"]:
    """Selects points for the positions: those with the most trusted rays first, until each image has enough."""
    rng = np.random.default_rng(0)
    count = np.bincount(point, weight, points)
    rank = np.empty(points)
    # points with equal numbers of rays are shuffled, so that they do not come from one corner
    rank[np.lexsort((rng.random(points), -np.minimum(np.round(count), 8)))] = np.arange(points)
    good = (weight > 0.5) & (count[point] >= 1.5)
    ray_image, ray_point = image[good], point[good]
    order = np.lexsort((rank[ray_point], ray_image))
    number = np.bincount(ray_image)
    place = np.arange(len(order)) - (np.cumsum(number) - number)[ray_image[order]]
    return np.unique(ray_point[order[place < RAYS]])


def positions(lines: Lines, bases: Bases) -> Positions:
    """The positions in which all lines meet best."""
    found = _positions(lines, None)
    if not _shrunk(found.centre, bases).any():
        return found
    again = _positions(lines, bases)
    return found if _shrunk(again.centre, bases).sum() >= _shrunk(found.centre, bases).sum() else again


def _shrunk(centre: Float[np.ndarray, "image 3"], bases: Bases) -> Bool[np.ndarray, " pair"]:
    """Pairs whose base is many times shorter than the angles between their rays say."""
    length = np.linalg.norm(centre[bases.pair[:, 1]] - centre[bases.pair[:, 0]], axis=1)
    clear = bases.parallax > CLEAR
    if not clear.any():
        return clear
    ratio = length / np.maximum(bases.parallax, CLEAR)
    return clear & (ratio < SHRUNK * np.median(ratio[clear]))


def _positions(lines: Lines, bases: Bases | None) -> Positions:
    across = np.eye(3) - lines.along[:, :, None] * lines.along[:, None, :]
    count = len(lines.image)
    distance, fit, depth, sine = np.ones(count), lines.weight, np.ones(count), np.zeros(count)
    centre, values = np.zeros((lines.images, 3)), np.zeros(2)
    for _ in range(PASSES):
        weight = fit * lines.weight / (distance * lines.sigma / lines.sigma.min()) ** 2
        centre, values, points = _smallest(lines, weight[:, None, None] * across, bases)
        vector = points[lines.point] - centre[lines.image]
        depth = (vector * lines.along).sum(1)
        if (lines.weight * np.sign(depth)).sum() < 0:
            centre, vector, depth = -centre, -vector, -depth
        distance = np.linalg.norm(vector, axis=1)
        sine = np.linalg.norm(np.cross(vector, lines.along), axis=1) / np.maximum(distance, 1e-300)
        distance = np.maximum(distance, NEAR * np.median(distance))
        scale = np.maximum(lines.sigma, _typical(sine, lines.weight)) * FIT
        fit = np.where(depth > 0, 1 / (1 + (sine / scale) ** 2), BEHIND)
    believed = lines.weight > 0.5
    return Positions(centre, values, float((depth[believed] > 0).mean()), np.where(depth > 0, sine, 1.0))


def _typical(sine: Float[np.ndarray, " ray"], weight: Float[np.ndarray, " ray"]) -> float:
    believed = sine[weight > 0.5]
    return float(1.4826 * np.median(believed)) if len(believed) else 0.0


def _smallest(
    lines: Lines, weighted: Float[np.ndarray, "ray 3 3"], bases: Bases | None
) -> tuple[Float[np.ndarray, "image 3"], Float[np.ndarray, "2"], Float[np.ndarray, "point 3"]]:
    """Centres of norm sqrt(images), the two smallest eigenvalues over the mean diagonal, and the points."""
    v = _added(weighted, lines.point, lines.points)
    trace = np.einsum("pii->p", v)
    flat = np.linalg.eigvalsh(v)[:, 0] < NARROW * lines.sigma.min() ** 2 * trace
    if flat.any():  # almost parallel rays: such a point has no information except rounding
        weighted = np.where(flat[lines.point][:, None, None], 0.0, weighted)
        v, trace = np.where(flat[:, None, None], np.eye(3), v), np.where(flat, 3.0, trace)
    v += (1e-12 * trace + 1e-300)[:, None, None] * np.eye(3)
    factor = np.linalg.cholesky(v)
    half = np.linalg.solve(factor, np.broadcast_to(np.eye(3), v.shape))  # L^-1
    e = weighted @ half[lines.point].swapaxes(1, 2)
    order = np.lexsort((lines.point, lines.image))
    starts = np.searchsorted(lines.image[order], np.arange(lines.images + 1))
    blocks = scipy.sparse.bsr_matrix(
        (e[order], lines.point[order], starts), (3 * lines.images, 3 * lines.points), blocksize=(3, 3)
    )
    u = _added(weighted, lines.image, lines.images)
    number = np.arange(lines.images + 1)
    diagonal = scipy.sparse.bsr_matrix((u, number[:-1], number), (3 * lines.images,) * 2, blocksize=(3, 3))
    reduced = (diagonal - blocks @ blocks.T.tobsr((3, 3))).tocsc()
    size = reduced.diagonal().mean()
    ridge = scipy.sparse.identity(3 * lines.images, format="csc") * (RIDGE * size)
    solver = splu((reduced + ridge).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    if bases is not None:
        centre, values = _with_lengths(reduced, bases, size, lines.images)
        return centre, values, _points_at(lines, weighted, half, centre)
    x = np.random.default_rng(0).normal(size=(lines.images, 3, VECTORS))
    for _ in range(ITERATIONS):
        x = _orthonormal(x)
        x = solver.solve(x.reshape(-1, VECTORS)).reshape(x.shape)
    x = _orthonormal(x).reshape(-1, VECTORS)
    values, vectors = np.linalg.eigh(x.T @ (reduced @ x))
    centre = (x @ vectors[:, 0]).reshape(-1, 3) * np.sqrt(lines.images)
    return centre, values[:2] / size, _points_at(lines, weighted, half, centre)


def _points_at(
    lines: Lines,
    weighted: Float[np.ndarray, "ray 3 3"],
    half: Float[np.ndarray, "point 3 3"],
    centre: Float[np.ndarray, "image 3"],
) -> Float[np.ndarray, "point 3"]:
    """The points that belong to the positions. `half`: inverse factors of their normal equations."""
    sums = _added(np.einsum("rij,rj->ri", weighted, centre[lines.image]), lines.point, lines.points)
    return np.einsum("pji,pjk,pk->pi", half, half, sums)


def _with_lengths(
    reduced: scipy.sparse.csc_matrix, bases: Bases, size: float, images: int
) -> tuple[Float[np.ndarray, "image 3"], Float[np.ndarray, "2"]]:
    """Centres with weak observations of the bases, of norm sqrt(images), and the value of the form at them."""
    clear = bases.parallax > CLEAR
    (first, second), along, length = bases.pair[clear].T, bases.along[clear], bases.parallax[clear]
    blocks = along[:, :, None] * along[:, None, :]
    matrix = reduced + scipy.sparse.identity(3 * images, format="csc") * (RIDGE * size)
    rows, columns = np.concatenate([first, second, first, second]), np.concatenate([first, second, second, first])
    values = PRIOR * size * np.concatenate([blocks, blocks, -blocks, -blocks])
    i, j = np.arange(3)[:, None], np.arange(3)
    at = (3 * rows[:, None, None] + i + 0 * j).ravel(), (3 * columns[:, None, None] + j + 0 * i).ravel()
    matrix = matrix + scipy.sparse.csc_matrix((values.ravel(), at), matrix.shape)
    right = np.zeros((images, 3))
    np.add.at(right, second, PRIOR * size * length[:, None] * along)
    np.add.at(right, first, -PRIOR * size * length[:, None] * along)
    x = splu(matrix.tocsc()).solve(right.ravel()).reshape(-1, 3)
    x -= x.mean(0)
    x *= np.sqrt(images) / np.linalg.norm(x)
    return x, np.array([x.ravel() @ (reduced @ x.ravel()) / images / size, np.nan])


def _orthonormal(x: Float[np.ndarray, "image 3 vector"]) -> Float[np.ndarray, "image 3 vector"]:
    """Orthonormal vectors without shifts."""
    x = x - x.mean(0)
    return np.linalg.qr(x.reshape(-1, x.shape[2]))[0].reshape(x.shape)


def _added(values: np.ndarray, of: Int[np.ndarray, " ray"], count: int) -> np.ndarray:
    """Sums over the rays of each image or point."""
    flat = values.reshape(len(values), -1)
    return np.stack([np.bincount(of, column, count) for column in flat.T], 1).reshape(count, *values.shape[1:])
