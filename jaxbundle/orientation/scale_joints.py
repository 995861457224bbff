"""Images whose distance from the others is determined by a few points only.

Rays of two images fix directions; the ratio of two bases is known by points that three images show. Pairs of images
that such a point connects have one scale; one that rests on fewer than three points is not checked by anything.
"""

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Int
from scipy.sparse.csgraph import connected_components

ENOUGH = 3  # points: one determines the ratio, a second one checks it, a third one decides
FIRST_POINTS = 200  # points of an image in a first trial; the image with most points is counted


def without_scale(
    image: Int[np.ndarray, " ray"], point: Int[np.ndarray, " ray"], images: Bool[np.ndarray, " image"]
) -> Bool[np.ndarray, " image"]:
    """Images of a part that fewer than three points connect to the largest group with one scale.

    Args:
        image, point: of the rays that fit.
        images: those of the part.
    """
    if images.sum() < 3:
        return np.zeros_like(images)
    chosen = images[image]
    image, point = image[chosen], point[chosen]
    number = np.bincount(image, minlength=len(images)).max(initial=1)
    # further points only add connections: where a share of the points connects all images, all points do
    for share in (FIRST_POINTS / number, 1.0):
        some = np.random.default_rng(0).random(point.max(initial=0) + 1)[point] < share
        found = _without_scale(image[some], point[some], images)
        if not found.any() or share >= 1.0:
            break
    return found


def _without_scale(
    image: Int[np.ndarray, " ray"], point: Int[np.ndarray, " ray"], images: Bool[np.ndarray, " image"]
) -> Bool[np.ndarray, " image"]:
    order = np.lexsort((image, point))
    i, p = image[order], point[order]
    first = np.ones(len(i), bool)
    first[1:] = (np.diff(i) != 0) | (np.diff(p) != 0)
    i, p = i[first].astype(np.int64), p[first]
    three = np.flatnonzero(p[2:] == p[:-2]) if len(p) > 2 else np.zeros(0, int)
    number = len(images)
    a, b, c = i[three], i[three + 1], i[three + 2]
    names, pairs = np.unique(np.concatenate([a * number + b, b * number + c, a * number + c]), return_inverse=True)
    ab, bc, ac = pairs.reshape(3, -1)
    links, count = np.unique(np.concatenate([ab * len(names) + bc, ab * len(names) + ac]), return_counts=True)
    links = links[count >= ENOUGH]
    if not len(links):
        return images.copy()
    kept, at = np.unique(np.concatenate(np.divmod(links, len(names))), return_inverse=True)
    nodes = names[kept]
    rows, columns = at.reshape(2, -1)
    graph = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (len(nodes), len(nodes)))
    part = connected_components(graph, directed=False)[1]
    covered = np.zeros_like(images)
    for k in range(part.max() + 1):
        of_group = np.zeros_like(images)
        for members in (nodes[part == k] // number, nodes[part == k] % number):
            of_group[members] = True
        covered = of_group if of_group.sum() > covered.sum() else covered
    return images & ~covered
