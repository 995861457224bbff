"""Intersecting points from rays with possible gross errors.

The first solution is the point closest to all trusted rays. If it does not fit them, intersections of pairs of its rays
are tried, and the one that fits the most rays is selected (MSAC, Torr and Zisserman 2000); then all fitting rays are
used together.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.geometry.vectors import components, cross, dot, squared
from jaxbundle.numerics.devices import on_cores
from jaxbundle.orientation.intersection import closest_to_rays

DEPTHS = 2.0 ** np.arange(-3, 7)  # share of a typical depth
NEARLY = 2.0  # times the minimum misfit
TRIALS = 12  # maximum number of pairs of rays of a point
FITS = 4.0  # standard deviations
TOGETHER = 100_000  # rays of a group of points


class Rays(NamedTuple):
    """Rays in the object system; `sigma`: standard deviation of a direction in rad; `believed`: trusted at first."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    along: Float[np.ndarray, "ray 3"]
    centre: Float[np.ndarray, "ray 3"]
    sigma: Float[np.ndarray, " ray"]
    believed: Bool[np.ndarray, " ray"]


class Met(NamedTuple):
    """Points, NaN if their rays do not intersect; mask of the fitting rays, and the misfits in standard deviations."""

    points: Float[np.ndarray, "point 3"]
    fits: Bool[np.ndarray, " ray"]
    off: Float[np.ndarray, " ray"]


def met(rays: Rays, count: int) -> Met:
    """Intersects all points robustly, in groups of points on all cores."""
    if len(rays.point) <= TOGETHER:
        return _met(rays, count)
    order = np.argsort(rays.point, kind="stable")
    ends = np.cumsum(np.bincount(rays.point, minlength=count))
    starts = np.unique([0, *np.searchsorted(ends, np.arange(TOGETHER, len(order), TOGETHER), side="right")])
    groups = list(zip(starts, [*starts[1:], count], strict=True))

    def of_group(group: tuple[int, int]) -> Met:
        low, high = group
        own = order[ends[low - 1] if low else 0 : ends[high - 1]]
        some = Rays(*(x[own] for x in rays))
        return _met(some._replace(point=some.point - low), high - low)

    found = list(on_cores(of_group, groups))
    points, fits, off = (np.concatenate(column) for column in zip(*found, strict=True))
    back = np.empty(len(order), int)
    back[order] = np.arange(len(order))
    return Met(points, fits[back], off[back])


def _met(rays: Rays, count: int) -> Met:
    few = (
        np.bincount(rays.point, rays.believed, count) < 2
    )  # with two rays the only pair may be wrong: all pairs are tried
    points = _closest(rays, rays.believed | few[rays.point], count)
    off = _off(rays, points)
    number = np.bincount(rays.point, minlength=count)
    bad = np.bincount(rays.point, ~(off <= FITS), count)
    doubtful = np.flatnonzero((bad > 0) & (number >= 3))
    if len(doubtful):
        points[doubtful] = _tried(rays, doubtful, points, count)
        off = _off(rays, points)
        for _ in range(2):
            again = _closest(rays, off <= FITS, count)
            new = _off(rays, again)
            better = _cost(new, rays.point, count) < _cost(off, rays.point, count)
            points = np.where(better[:, None], again, points)
            off = np.where(better[rays.point], new, off)
    return Met(points, off <= FITS, off)


def _closest(rays: Rays, used: Bool[np.ndarray, " ray"], count: int) -> Float[np.ndarray, "point 3"]:
    points = np.array(closest_to_rays(rays.along[used].T, rays.centre[used].T, rays.point[used], count).T)
    points[np.bincount(rays.point[used], minlength=count) < 2] = np.nan
    return points


def _off(rays: Rays, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " ray"]:
    """Angles in standard deviations; infinite behind the image or without a point."""
    sine, depth = _passed(rays, points)
    return np.where(depth > 0, sine / rays.sigma, np.inf)


def _passed(
    rays: Rays, points: Float[np.ndarray, "point 3"]
) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, " ray"]]:
    """Sines of the angles between rays and points, and depths of the points along the rays."""
    vector, along = components(points[rays.point] - rays.centre), components(rays.along)
    sine = np.sqrt(np.asarray(squared(cross(vector, along)))) / np.maximum(np.sqrt(np.asarray(squared(vector))), 1e-300)
    return sine, np.asarray(dot(vector, along))


def _cost(off: Float[np.ndarray, " ray"], point: Int[np.ndarray, " ray"], count: int) -> Float[np.ndarray, " point"]:
    return np.bincount(point, np.minimum(np.nan_to_num(off, nan=np.inf) / FITS, 1.0) ** 2, count)


def _tried(
    rays: Rays, doubtful: Int[np.ndarray, " chosen"], points: Float[np.ndarray, "point 3"], count: int
) -> Float[np.ndarray, "chosen 3"]:
    """Selects the intersection of two rays of each point, or the present one, that fits the most rays."""
    rng = np.random.default_rng(0)
    place = np.full(count, -1)
    place[doubtful] = np.arange(len(doubtful))
    of = np.flatnonzero(place[rays.point] >= 0)
    some = Rays(*(x[of] for x in rays))._replace(point=place[rays.point[of]])
    number = np.bincount(some.point)
    order = np.argsort(some.point, kind="stable")
    start = np.cumsum(number) - number
    best, chosen = _cost(_off(some, points[doubtful]), some.point, len(doubtful)), points[doubtful].copy()
    for _ in range(TRIALS):
        first = rng.integers(0, number)
        second = (first + rng.integers(1, number)) % number
        pair = order[np.concatenate([start + first, start + second])]
        two = Rays(*(x[pair] for x in some))
        new = _closest(two, np.ones(len(pair), bool), len(doubtful))
        cost = _cost(_off(some, new), some.point, len(doubtful))
        better = cost < best
        best, chosen[better] = np.where(better, cost, best), new[better]
    return chosen


class Apart(NamedTuple):
    """Points whose rays do not meet in front of their images, and which of them are put behind."""

    points: Float[np.ndarray, "point 3"]
    behind: Bool[np.ndarray, " point"]


def apart(rays: Rays, typical: float, noise: float, count: int) -> Apart:
    """Where to start points whose rays do not meet in front of their images.

    Rays of a rough start that are nearly parallel may meet behind their images, or at infinity, from where an
    adjustment does not come back: such a point is put in front. Rays that diverge by more than their noise fit no point
    in front; there it would run to infinity and bend the images on its way. The image equation knows no sides, so such
    a point is put where its rays meet, if they do.

    Args:
        rays: all rays of the points.
        typical: depth of the other points.
        noise: typical angle off of the rays of the other points, in standard deviations of a direction.
        count: number of points.
    """
    front, least = _ahead(rays, typical, count)
    crossing = _closest(rays, np.ones(len(rays.point), bool), count)
    sine, depth = _passed(rays, crossing)
    opposite = np.bincount(rays.point, depth < 0, count) == np.bincount(rays.point, minlength=count)
    off = _rms(np.nan_to_num(sine, nan=np.inf), rays, count)
    behind = opposite & (off <= FITS * noise) & (least > FITS * noise) & (least > NEARLY * off)
    return Apart(np.where(behind[:, None], crossing, front), behind)


def _rms(sine: Float[np.ndarray, " ray"], rays: Rays, count: int) -> Float[np.ndarray, " point"]:
    """Root mean square angle off of the rays of each point, in standard deviations."""
    number = np.maximum(np.bincount(rays.point, minlength=count), 1)
    return np.sqrt(np.bincount(rays.point, (sine / rays.sigma) ** 2, count) / number)


def _ahead(rays: Rays, typical: float, count: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """Points in front of their images, as near as the rays pass them nearly as well as farther away, and the least
    misfit in front."""
    number = np.maximum(np.bincount(rays.point, minlength=count), 1)
    places, misfits = [], []
    for depth in typical * DEPTHS:
        at = rays.centre + depth * rays.along
        place = np.stack([np.bincount(rays.point, column, count) for column in at.T], 1) / number[:, None]
        sine, along = _passed(rays, place)
        places.append(place)
        misfits.append(_rms(np.where(along > 0, sine, 1.0), rays, count))
    misfit = np.stack(misfits)
    first = np.argmax(misfit <= NEARLY * misfit.min(0), axis=0)
    return np.stack(places)[first, np.arange(count)], misfit.min(0)
