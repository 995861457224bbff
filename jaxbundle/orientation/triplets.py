"""Relative rotations of three images checked against each other: R_ki R_jk R_ij is the unit matrix."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation


def triplet_errors(
    pairs: Int[np.ndarray, "pair 2"], rotation: Float[np.ndarray, "pair 3 3"]
) -> tuple[Int[np.ndarray, "triplet 3"], Float[np.ndarray, " triplet"]]:
    """Triplets of images all of whose pairs are oriented, and the angles in rad by which their rotations do not close.

    Args:
        pairs: image numbers, the smaller one first.
        rotation: relative rotation, second_from_first.
    """
    number = {(int(i), int(j)): k for k, (i, j) in enumerate(pairs)}
    later: dict[int, list[int]] = {}
    for i, j in number:
        later.setdefault(i, []).append(j)
    found = [
        (number[i, j], number[j, k], number[i, k])
        for i, others in later.items()
        for j in others
        for k in others
        if (j, k) in number
    ]
    if not found:
        return np.zeros((0, 3), int), np.zeros(0)
    ij, jk, ik = np.array(found).T
    closed = rotation[ik].swapaxes(1, 2) @ rotation[jk] @ rotation[ij]
    return np.stack([pairs[ij, 0], pairs[ij, 1], pairs[jk, 1]], 1), Rotation.from_matrix(closed).magnitude()
