"""Attitudes of all images from the relative rotations of pairs, by robust averaging.

With attitudes A_i (camera_from_block) and relative rotations R_ji = A_j A_i^T,

    e_ij = Log(A_j^T R_ji A_i),        A_i <- A_i Exp(x_i),        e_ij + x_i - x_j = 0

(Chatterjee, Govindu 2018). The coefficients are the same for all three components: one Laplacian, three right-hand
sides. The start is a spanning tree of the best pairs. First the sum of |e| is minimised, then that of Geman and
McClure, whose scale follows the median of |e|. For a pair with two orientations the nearer one is used.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from jaxbundle.orientation.block_pairs import BlockPairs

L1_PASSES, ROBUST_PASSES = 6, 30
SMALLEST = 1e-4  # rad; smaller residuals do not increase the weight
FLOOR = np.radians(0.05)  # iterations of the robust scale
SETTLED = 1e-9  # rad
REJECTED_ANGLE, REJECTED_SCALES = np.radians(3.0), 6.0  # a pair with a larger misfit than both limits is not used
RIDGE = 1e-9  # regularisation of the Laplacian, for long chains
SECOND = 1.5  # ratio of the costs of the second and the best orientation: below this the second may be correct


class Attitudes(NamedTuple):
    """Attitudes camera_from_block; the systems of different parts are independent.

    `part`: index of the part of each image. `residual`: of each pair in rad; `used`: pairs that agree; `second`: pairs
    whose second orientation is used.
    """

    rotation: Float[np.ndarray, "image 3 3"]
    part: Int[np.ndarray, " image"]
    residual: Float[np.ndarray, " pair"]
    used: Bool[np.ndarray, " pair"]
    second: Bool[np.ndarray, " pair"]


def averaged(pairs: BlockPairs, images: int) -> Attitudes:
    """Computes the attitudes of all images in their parts; `pairs`: accepted ones."""
    if not len(pairs.pairs):
        none = np.zeros(0, bool)
        return Attitudes(np.tile(np.eye(3), (images, 1, 1)), np.arange(images), np.zeros(0), none, none)
    attitudes = _tree(pairs, images)
    scale = FLOOR
    for number in range(L1_PASSES + ROBUST_PASSES):
        error, _ = _errors(attitudes, pairs)
        size = np.linalg.norm(error, axis=1)
        if number < L1_PASSES:
            weight = 1 / np.maximum(size, SMALLEST)
        else:
            scale = max(3 * 1.4826 * float(np.median(size)), FLOOR)
            weight = (scale**2 / (scale**2 + size**2)) ** 2
        change = _solved(pairs.pairs, weight, error, images)
        attitudes = attitudes @ Rotation.from_rotvec(change).as_matrix()
        if number >= L1_PASSES and np.linalg.norm(change, axis=1).mean() < SETTLED:
            break
    error, second = _errors(attitudes, pairs)
    size = np.linalg.norm(error, axis=1)
    used = size <= max(REJECTED_ANGLE, REJECTED_SCALES * scale)
    _, part = connected_components(_graph(pairs.pairs[used], np.ones(used.sum()), images), directed=False)
    return Attitudes(attitudes, part, size, used, second)


def _graph(
    pairs: Int[np.ndarray, "pair 2"], weight: Float[np.ndarray, " pair"], images: int
) -> scipy.sparse.csr_matrix:
    return scipy.sparse.csr_matrix((weight, (pairs[:, 0], pairs[:, 1])), (images, images))


def _tree(pairs: BlockPairs, images: int) -> Float[np.ndarray, "image 3 3"]:
    """Attitudes along a spanning tree of the pairs with the most fitting rays, in each part from its first image."""
    graph = _graph(pairs.pairs, 1 / (1.0 + pairs.fits), images)
    tree = minimum_spanning_tree(graph)
    tree = (tree + tree.T).tocsr()
    number = {(int(i), int(j)): k for k, (i, j) in enumerate(pairs.pairs)}
    attitudes, done = np.tile(np.eye(3), (images, 1, 1)), np.zeros(images, bool)
    for root in range(images):
        if done[root]:
            continue
        order, before = breadth_first_order(tree, root, directed=False)
        done[order] = True
        for image in order[1:]:
            parent = int(before[image])
            forward = number.get((parent, int(image)))
            if forward is None:
                attitudes[image] = pairs.rotation[number[int(image), parent], 0].T @ attitudes[parent]
            else:
                attitudes[image] = pairs.rotation[forward, 0] @ attitudes[parent]
    return attitudes


def _errors(
    attitudes: Float[np.ndarray, "image 3 3"], pairs: BlockPairs
) -> tuple[Float[np.ndarray, "pair 3"], Bool[np.ndarray, " pair"]]:
    """Misfit e of the nearer orientation of each pair, and whether it is the second one."""
    i, j = pairs.pairs.T
    errors = np.stack(
        [
            Rotation.from_matrix(attitudes[j].swapaxes(1, 2) @ pairs.rotation[:, k] @ attitudes[i]).as_rotvec()
            for k in range(2)
        ]
    )
    size = np.linalg.norm(errors, axis=2)
    second = (pairs.second_cost < SECOND) & (size[1] < size[0])
    return np.where(second[:, None], errors[1], errors[0]), second


def _solved(
    pairs: Int[np.ndarray, "pair 2"],
    weight: Float[np.ndarray, " pair"],
    error: Float[np.ndarray, "pair 3"],
    images: int,
) -> Float[np.ndarray, "image 3"]:
    i, j = pairs.T
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    values = np.concatenate([weight, weight, -weight, -weight])
    laplacian = scipy.sparse.csc_matrix((values, (rows, columns)), (images, images))
    # the rotation of each part is undetermined: the regularisation fixes it
    laplacian = laplacian + (RIDGE * weight.mean()) * scipy.sparse.identity(images, format="csc")
    right = np.zeros((images, 3))
    np.add.at(right, i, -weight[:, None] * error)
    np.add.at(right, j, weight[:, None] * error)
    return splu(laplacian.tocsc()).solve(right)
