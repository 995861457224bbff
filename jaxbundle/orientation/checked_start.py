"""Checking approximate values: absurd ones are replaced if measurements determine them beyond doubt.

An image is absurd if the angles of half of its rays exceed an image field (`sight.Sight.field`), both to the given
points and to their intersections. It is replaced by a resection if this reduces the angles to a tenth. A point is
absurd if the angles of half of its rays exceed an image field. It is replaced by the intersection of its rays under the
same condition, a control point by its observed coordinates. Rough approximate values are not changed at all: the
adjustment converges from them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding
from jaxbundle.geometry.rotation import RotationSystem
from jaxbundle.numerics.host import tree_with
from jaxbundle.orientation.alternatives import mirrored
from jaxbundle.orientation.oriented import Oriented, oriented
from jaxbundle.orientation.replaced import hopeless_points, replaced_images, replaced_points
from jaxbundle.orientation.sight import (
    Sight,
    intersected,
    medians,
    mostly_beyond,
    photo_vectors,
    relative_off,
    sight_of,
)

ABSURD = 1.0  # image fields; for an image rotated by 90 degrees the angle is 1.4, by 180 degrees 2
CONSISTENT = 0.3  # image fields; an image rotated by 180 degrees exceeds this although its intersected points follow it
FAR_SMALLER = 0.1  # maximum share of the angles after a replacement
ROUGH_FIT = 0.1  # image fields; remaining angles due to rough points
MIN_POINTS = 5  # minimum points of an accepted resection: four and one check; for control points only, four
CONTROL_POINTS = 1  # minimum rays of an image that contradict it
ROUNDS = 6  # rounds: resections of one round add points for the next
SINGLE = 20  # number of worst images that are tried as the only wrong one
SAME = 1e-9  # relative rounding of a coordinate
FAR = 20.0  # multiple of the depth of the other points for a point whose rays do not intersect
DIVERGING = 6.0  # times the median angle (four standard deviations): rays that fit no point in front, however far


class _Start(NamedTuple):
    """Approximate values during the check; `angles` of replaced images, otherwise NaN."""

    sight: Sight
    angles: Float[np.ndarray, "image 3"]

    @property
    def replaced(self) -> Bool[np.ndarray, " image"]:
        return np.isfinite(self.angles[:, 0])


def with_checked_start(block: Block) -> tuple[Block, tuple[Finding, ...]]:
    """Replaces absurd approximate values of the block if that is beyond doubt, and reports the replacements.

    Images and coordinates that the datum or the user fixes are never changed. Traced values, and plausible ones, are
    returned unchanged.
    """
    if not block.concrete or not len(block.structure.ray_image):
        return block, ()
    with np.errstate(all="ignore"):
        sight = sight_of(block)
        if mirrored(sight) is not None:  # no attitude and no point can compensate for that
            return block, ()
        checked = checked_start(block, sight)
    return checked.block, checked.findings


class CheckedStart(NamedTuple):
    """A block with a checked start, the replacements, its rays, and the images that are still absurd."""

    block: Block
    findings: tuple[Finding, ...]
    sight: Sight
    suspects: Bool[np.ndarray, " image"]


def checked_start(block: Block, sight: Sight) -> CheckedStart:
    """Implements `with_checked_start` for a concrete block with prepared rays that are not mirrored."""
    suspects = suspect_images(sight)
    start = _Start(sight, np.full(sight.centre.shape, np.nan))
    if suspects.any():
        start = _with_images(start, block)
        suspects = suspect_images(start.sight)
    points, hopeless = _with_points(start.sight, block, suspects)
    changed = (points != sight.points).any(1) & np.isfinite(points).all(1)
    if not start.replaced.any() and not changed.any():
        return CheckedStart(block, (), sight, suspects)
    findings = (
        *replaced_images(block, start.replaced, start.sight),
        *replaced_points(block, changed & ~hopeless & sight.is_known, points, "observed values"),
        *replaced_points(block, changed & ~hopeless & ~sight.is_known, points, "the intersection of {} rays"),
        *hopeless_points(block, hopeless),
    )
    return CheckedStart(_with_values(block, start, points), findings, start.sight._replace(points=points), suspects)


def _with_values(block: Block, start: _Start, points: Float[np.ndarray, "point 3"]) -> Block:
    own = np.asarray(block.exterior.angles)
    angles = np.where(start.replaced[:, None], start.angles, own)
    return tree_with(
        lambda b: (b.exterior.projection_centre, b.exterior.angles, b.object_points),
        block,
        (start.sight.centre, angles, points),
    )


def suspect_images(sight: Sight) -> Bool[np.ndarray, " image"]:
    """Images whose rays agree neither with their given points nor with each other."""
    count = len(sight.centre)
    # if images share one position, such as a mean, some may be right by chance
    limit = np.where(_shared_place(sight), CONSISTENT, ABSURD)
    absurd = mostly_beyond(relative_off(sight, sight.believed), limit, sight.image, count)
    if not absurd.any():
        return absurd
    return absurd & ~_agree(sight, np.ones(count, bool))


def _shared_place(sight: Sight) -> Bool[np.ndarray, " image"]:
    """Mask of the images with the same centre as another image."""
    _, inverse, count = np.unique(sight.centre, axis=0, return_inverse=True, return_counts=True)
    return count[inverse.ravel()] > 1


def _agree(sight: Sight, images: Bool[np.ndarray, " image"]) -> Bool[np.ndarray, " image"]:
    """Mask of the images whose rays intersect those of the chosen ones in front of the cameras."""
    meet = intersected(sight, images)
    q = np.where(meet.in_front[sight.point], relative_off(sight, meet.points), np.inf)
    several = np.bincount(sight.point[images[sight.image]], minlength=len(sight.points)) >= 2
    tie = several[sight.point] & images[sight.image] & ~sight.is_known[sight.point]
    met = medians(q[tie], sight.image[tie], len(sight.centre)) <= CONSISTENT
    known = sight.is_known[sight.point]
    count = np.bincount(sight.image[known], minlength=len(sight.centre))
    control = medians(relative_off(sight, sight.known)[known], sight.image[known], len(sight.centre))
    return met & ~((count >= CONTROL_POINTS) & ~(control <= ABSURD))


def _with_images(start: _Start, block: Block) -> _Start:
    """Replaces absurd orientations."""
    may = block.structure.exterior_free.all(1)
    system = block.structure.rotation_system
    for _ in range(ROUNDS):
        suspects = suspect_images(start.sight)
        if not (suspects & may).any():
            break
        before = start.replaced.sum()
        for points, usable in _point_sets(start.sight, suspects):
            left = np.flatnonzero(suspects & may & ~start.replaced)
            if len(left):
                start = _resected(start, left, points, usable, system)
        if start.replaced.sum() == before:
            single = _the_wrong_one(start.sight, suspects, may & ~start.replaced)
            if single is None:
                break
            points, usable = _points_of_others(start.sight, single)
            start = _resected(start, np.array([single]), points, usable, system)
            if start.replaced.sum() == before:
                break
    return start


def _point_sets(
    sight: Sight, suspects: Bool[np.ndarray, " image"]
) -> list[tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, " ray"]]]:
    """Points for a resection, with their rays: all given points, control only, or those of the good images."""
    known = sight.is_known[sight.point]
    given = sight.believed
    sets = [(given, sight.is_believed[sight.point]), (given, known)]
    if not suspects.all():
        sets.append(_met(sight, ~suspects))
    return sets


def _met(
    sight: Sight, images: Bool[np.ndarray, " image"]
) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, " ray"]]:
    """Control points, and intersections of rays of these images."""
    meet = intersected(sight, images)
    points = np.where(sight.is_known[:, None], sight.known, meet.points)
    return points, (sight.is_known | meet.in_front)[sight.point]


def _points_of_others(sight: Sight, image: int) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, " ray"]]:
    return _met(sight, np.arange(len(sight.centre)) != image)


def _resected(
    start: _Start,
    images: Int[np.ndarray, " chosen"],
    points: Float[np.ndarray, "point 3"],
    usable: Bool[np.ndarray, " ray"],
    system: RotationSystem,
) -> _Start:
    """Replaces images by their resection from these points, if it is beyond doubt."""
    sight = start.sight
    count = np.bincount(sight.image[usable], minlength=len(sight.centre))
    images = images[count[images] >= MIN_POINTS - sight.is_known[sight.point[usable]].all()]
    if not len(images):
        return start
    new = oriented(sight, images, points, usable, system)
    now = medians(relative_off(sight, points)[usable], sight.image[usable], len(sight.centre))[images]
    good = sure(new, sight.field[images], now)
    rotation, centre, angles = sight.rotation.copy(), sight.centre.copy(), start.angles.copy()
    rotation[images[good]], centre[images[good]] = new.rotation[good], new.centre[good]
    angles[images[good]] = new.angles[good]
    return _Start(sight._replace(rotation=rotation, centre=centre), angles)


def sure(
    new: Oriented, field: Float[np.ndarray, " image"], now: Float[np.ndarray, " image"]
) -> Bool[np.ndarray, " image"]:
    """Whether orientations are beyond doubt: `now` is the median angle for the given ones, in image fields."""
    relative = new.median / field
    return (relative <= ROUGH_FIT) & (relative <= FAR_SMALLER * now) & (new.behind <= FAR_SMALLER)


def _the_wrong_one(sight: Sight, suspects: Bool[np.ndarray, " image"], may: Bool[np.ndarray, " image"]) -> int | None:
    """The image without which the rays of all others intersect, if there is one."""
    everything = np.ones(len(sight.centre), bool)
    best, at = int(_agree(sight, everything).sum()), None
    worst = medians(relative_off(sight, sight.believed), sight.image, len(sight.centre))
    for i in np.flatnonzero(suspects & may)[np.argsort(-worst[suspects & may])][:SINGLE]:
        others = everything.copy()
        others[i] = False
        agreeing = int(_agree(sight, others).sum())
        if agreeing > best:
            best, at = agreeing, int(i)
    return at


def _with_points(
    sight: Sight, block: Block, suspects: Bool[np.ndarray, " image"]
) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, " point"]]:
    """Replaces absurd coordinates (of control by observed ones).

    Points whose rays do not intersect get a position far in front, unless they diverge by more than the angles of other
    rays: in front such a point would go to infinity and bend its images (`robust_intersection.apart`).
    """
    count = len(sight.points)
    rays = np.bincount(sight.point, minlength=count)
    q = relative_off(sight, sight.points)
    absurd = block.structure.point_free.all(1) & (rays >= 2) & mostly_beyond(q, ABSURD, sight.point, count)
    none = np.zeros(count, bool)
    if not absurd.any():
        return sight.points, none
    now = medians(q, sight.point, count)
    good_images = ~suspects
    absurd &= np.bincount(sight.point[good_images[sight.image]], minlength=count) >= 2
    meet = intersected(sight, good_images)
    candidates = np.where(sight.is_known[:, None], sight.known, meet.points)
    new = medians(relative_off(sight, candidates), sight.point, count)
    new = np.where(meet.in_front | sight.is_known, new, np.inf)
    better = absurd & (new <= FAR_SMALLER * now) & (new <= CONSISTENT)
    points = np.where(better[:, None], candidates, sight.points)
    # given coordinates are not changed: only intersections behind the cameras have no information
    own = np.linalg.norm(sight.points - meet.points, axis=1) <= SAME * np.linalg.norm(meet.points, axis=1)
    hopeless = absurd & ~better & ~meet.in_front & own & ~sight.is_known
    far = _far(sight)
    hopeless &= medians(relative_off(sight, far), sight.point, count) <= DIVERGING * np.median(q)
    return np.where(hopeless[:, None], far, points), hopeless


def _far(sight: Sight) -> Float[np.ndarray, "point 3"]:
    """Points on the mean of their rays, far behind the others but in front of the cameras."""
    count = len(sight.points)
    depth = -photo_vectors(sight, sight.believed)[:, 2]
    typical = np.median(depth[depth > 0]) if (depth > 0).any() else 1.0
    along = np.einsum("rij,rj->ri", sight.rotation[sight.image], np.c_[sight.plane, -np.ones(len(sight.plane))])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    rays = np.maximum(np.bincount(sight.point, minlength=count), 1)

    def mean(rows: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, "point 3"]:
        return np.stack([np.bincount(sight.point, column, count) / rays for column in rows.T], -1)

    return mean(sight.centre[sight.image]) + FAR * typical * mean(along)
