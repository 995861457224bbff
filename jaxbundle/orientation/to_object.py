"""Transforming a part of a block to the object system by its anchors, which may have gross errors.

Three anchors with all coordinates that are not on a line determine the similarity in closed form; the triple that
agrees with the most anchors is selected. The deformations of a part exceed its sigmas, so the tolerance is proportional
to its extent. With fewer anchors the methods are, in this order: given attitudes, with a scale and a shift; plan and
height control; anchors on a line with the assumption that the mean view is vertical; and, without anchors, a separate
system with mean base 1 and the mean view downwards or the centres in a horizontal plane. A part is never mirrored.
"""

from enum import Enum
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.orientation.absolute_orientations import absolute_orientation
from jaxbundle.orientation.anchors import Anchors

BENT = 0.005  # share of the extent: standard deviation of a position in a part before the adjustment
WILD = 0.1  # share of the extent: with a larger median misfit there is no agreement
ON_A_LINE = 1e-3  # ratio of second and first singular value of the used anchors
FLAT = 0.02  # the same for plan and height control, which requires more
ALL_TRIPLES = 20  # maximum number of anchors for a test of all triples
TRIPLES = 1000
ALIKE = np.cos(np.radians(40.0))  # cosine: views that agree
PASSES = 10


class Basis(Enum):
    """The method of the transformation of a part to its system."""

    ANCHORS = "control and stations"
    ATTITUDES = "given attitudes and positions"
    PLAN_HEIGHT = "plan and height control"
    LINE = "anchors on a line and the assumption that the mean view is vertical"
    JOINED = "common points with the largest part"
    GIVEN = "given orientations and control"
    OWN = "a separate system"


class Placed(NamedTuple):
    """The similarity X = scale R x + shift, its method, and misfits of the anchors; `used`: agreeing anchors."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]
    basis: Basis
    misfits: Float[np.ndarray, " anchor"]
    used: Bool[np.ndarray, " anchor"]

    def __call__(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        """Transforms positions to the object system."""
        return self.scale * points @ self.rotation.T + self.shift


class Views(NamedTuple):
    """Images of a part: centres, viewing directions, rotations part_from_image and given attitudes."""

    centre: Float[np.ndarray, "image 3"]
    rotation: Float[np.ndarray, "image 3 3"]
    attitude: Float[np.ndarray, "image 3 3"]

    @property
    def direction(self) -> Float[np.ndarray, "image 3"]:
        """Unit vectors along the camera axes."""
        return -self.rotation[:, :, 2]


def closed_form(
    x: Float[np.ndarray, "... point 3"], o: Float[np.ndarray, "... point 3"], w: Float[np.ndarray, "... point"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scale, rotation and shift of weighted points, and singular values, for many sets at once on the host."""
    w = w / w.sum(-1, keepdims=True)
    cx, co = (w[..., None] * x).sum(-2, keepdims=True), (w[..., None] * o).sum(-2, keepdims=True)
    u, d, vt = np.linalg.svd(np.swapaxes(o - co, -1, -2) @ (w[..., None] * (x - cx)))
    s = np.ones(d.shape)
    s[..., 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    r = (u * s[..., None, :]) @ vt
    scale = np.asarray((d * s).sum(-1) / np.maximum((w * ((x - cx) ** 2).sum(-1)).sum(-1), 1e-300))
    shift = co[..., 0, :] - scale[..., None] * np.einsum("...ij,...j->...i", r, cx[..., 0, :])
    return scale, r, shift, d


def placed(anchors: Anchors, views: Views) -> Placed:
    """Transforms the part to the object system, or to a separate one."""
    full = anchors.full
    if full.sum() >= 3:
        found = _by_triples(anchors)
        if found is not None:
            return found
    for way in (_by_attitudes, _by_plan_and_height, _by_line):
        found = way(anchors, views)
        if found is not None and np.isfinite(found.scale) and found.scale > 0:
            return found
    return own_system(anchors, views)


def _judged(anchors: Anchors, at: tuple, basis: Basis) -> Placed:
    """Adds the misfits of the known coordinates."""
    scale, rotation, shift = at[:3]
    v = scale * anchors.model @ rotation.T + shift - anchors.object_points
    misfits = np.sqrt(np.nansum(v**2, 1))
    return Placed(float(scale), rotation, shift, basis, misfits, misfits <= 3 * _tolerances(anchors))


def _extent(anchors: Anchors) -> float:
    o = anchors.object_points[anchors.full]
    o = anchors.object_points if len(o) < 2 else o
    return float(np.linalg.norm(np.nan_to_num(np.nanmax(o, 0) - np.nanmin(o, 0)))) if len(o) else 0.0


def _tolerances(anchors: Anchors) -> Float[np.ndarray, " anchor"]:
    return np.sqrt(np.nansum(anchors.sigmas**2, 1) + 3 * (BENT * _extent(anchors)) ** 2)


def _by_triples(anchors: Anchors) -> Placed | None:
    full = anchors.only(anchors.full)
    x, o, tolerance = full.model, full.object_points, _tolerances(anchors)[anchors.full]
    count = len(x)
    if count <= ALL_TRIPLES:
        triples = np.array(list(combinations(range(count), 3)))
    else:
        triples = np.random.default_rng(0).random((TRIPLES, count)).argpartition(3, axis=1)[:, :3]
    scale, r, shift, d = closed_form(x[triples], o[triples], np.ones(triples.shape))
    v = scale[:, None, None] * np.einsum("tij,pj->tpi", r, x) + shift[:, None] - o
    cost = np.minimum((v**2).sum(2) / (3 * tolerance) ** 2, 1).sum(1)
    best = int(np.argmin(np.where((d[:, 1] > ON_A_LINE * d[:, 0]) & np.isfinite(cost), cost, np.inf)))
    misfit = np.sqrt((v[best] ** 2).sum(1))
    used = misfit <= 3 * tolerance
    extent = _extent(anchors)
    if used.sum() < 3 or np.median(misfit[used]) > WILD * extent:
        return None
    at = closed_form(x, o, used / tolerance**2)
    for _ in range(PASSES):
        misfit = np.linalg.norm(at[0] * x @ at[1].T + at[2] - o, axis=1)
        at = closed_form(x, o, used / (tolerance**2 + misfit**2))
    d = at[3]
    return None if d[1] <= ON_A_LINE * d[0] else _judged(anchors, at, Basis.ANCHORS)


def _by_attitudes(anchors: Anchors, views: Views) -> Placed | None:
    known = np.isfinite(views.attitude).all((1, 2))
    coordinates = np.isfinite(anchors.object_points)
    if not known.any() or coordinates.sum() < 4 or not coordinates.any(0).all():
        return None
    each = views.attitude[known] @ views.rotation[known].swapaxes(1, 2)
    u, _, vt = np.linalg.svd(each.sum(0))
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    turned = anchors.model @ rotation.T
    rows, columns = np.nonzero(coordinates)
    a = np.c_[turned[rows, columns], np.eye(3)[columns]]
    scale, *shift = np.linalg.lstsq(a, anchors.object_points[rows, columns], rcond=None)[0]
    return _judged(anchors, (scale, rotation, np.array(shift)), Basis.ATTITUDES)


def _by_plan_and_height(anchors: Anchors, views: Views) -> Placed | None:
    given = np.asarray(np.isfinite(anchors.object_points))
    if given[:, :2].all(1).sum() < 2 or given[:, 2].sum() < 3 or given.sum() < 7:
        return None
    extent = np.linalg.svd(anchors.model - anchors.model.mean(0), compute_uv=False)
    if extent[1] < FLAT * extent[0] or np.nanmax(np.nanstd(anchors.object_points, 0)) == 0:
        return None
    o = np.where(
        np.asarray(given[:, :2].all(1))[:, None] | np.array([False, False, True]), anchors.object_points, np.nan
    )
    some = np.isfinite(o).any(1)
    sigmas = np.broadcast_to(_tolerances(anchors)[:, None], o.shape)[some]
    found = absolute_orientation(anchors.model[some], o[some], sigmas, projection_centres=views.centre)
    if not bool(found.determined) or bool(found.on_a_line):
        return None
    at = found.similarity
    return _judged(anchors, (float(at.scale), np.asarray(at.rotation), np.asarray(at.translation)), Basis.PLAN_HEIGHT)


def _by_line(anchors: Anchors, views: Views) -> Placed | None:
    full = anchors.only(anchors.full)
    mean = views.direction.mean(0)
    if len(full.model) < 2 or (views.direction @ mean).min() < ALIKE * np.linalg.norm(mean) or not mean.any():
        return None
    x, o = full.model - full.model.mean(0), full.object_points - full.object_points.mean(0)
    along_model, along_object = (np.linalg.svd(y)[2][0] for y in (x, o))
    if (x @ along_model) @ (o @ along_object) < 0:
        along_object = -along_object
    extent, wanted = np.linalg.norm(x), np.linalg.norm(o)
    if not extent or not wanted or abs(along_object[2]) > ALIKE:
        return None
    rotation = _frame(along_object, np.array([0.0, 0.0, -1.0])) @ _frame(along_model, mean).T
    scale = wanted / extent
    shift = full.object_points.mean(0) - scale * rotation @ full.model.mean(0)
    found = _judged(anchors, (scale, rotation, shift), Basis.LINE)
    return found if np.median(found.misfits) <= WILD * _extent(anchors) else None


def _frame(first: Float[np.ndarray, "3"], near: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Orthonormal columns: a direction, the orthogonal direction nearest to another one, and the third."""
    first = first / np.linalg.norm(first)
    second = near - (near @ first) * first
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)


def own_system(anchors: Anchors, views: Views) -> Placed:
    """A separate system of the part, with unit mean distance of each centre from the nearest other one."""
    centre, mean = views.centre, views.direction.mean(0)
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2) if len(centre) <= 2000 else np.zeros((0, 0))
    distance[distance <= 1e-9 * max(distance.max(initial=0.0), 1e-300)] = np.nan
    with np.errstate(all="ignore"):
        base = float(np.nanmedian(np.nanmin(distance, 1))) if np.isfinite(distance).any() else 1.0
    if (views.direction @ mean).min() > ALIKE * np.linalg.norm(mean):
        down = mean
    else:
        down = np.linalg.svd(centre - centre.mean(0))[2][2]
        down = -down if down @ mean < 0 else down
    axis = np.eye(3)[np.argmin(np.abs(down))]
    frame = _frame(-down, axis)
    rotation = np.stack([frame[:, 1], frame[:, 2], frame[:, 0]])
    scale = 1 / base if base > 0 else 1.0
    shift = -scale * rotation @ centre.mean(0)
    none = np.zeros(len(anchors.number))
    return Placed(scale, rotation, shift, Basis.OWN, none + np.nan, none > 0)
