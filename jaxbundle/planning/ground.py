"""Positions of the object points of a flight: tie points, control and check points by layouts."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxbundle.planning.flight import ControlSet, FlightPlan
from jaxbundle.planning.lines import Frame, Stations

JITTER = 0.35  # share of the grid's spacing in both directions
ROW_REACH = 0.35  # share of an image's height: distance of the outer control from the axes of the outer strips
SAME = 1e-6  # share of the base: closer points are one point


class GroundPoints(NamedTuple):
    """Points in object coordinates, X and Y: control points, check points of a list, tie points."""

    xy: Float[np.ndarray, "point 2"]
    sigmas: Float[np.ndarray, "point 3"]
    """Sigmas of control coordinates: NaN if not observed, 0 if fixed."""
    listed_check: Bool[np.ndarray, " point"]


class Extent(NamedTuple):
    """The area of a layout in local coordinates: a rectangle along the strips, or a polygon."""

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    area: Float[np.ndarray, "corner 2"]


def ground_points(plan: FlightPlan, frame: Frame, stations: Stations, rng: np.random.Generator) -> GroundPoints:
    """Makes all points of a flight."""
    along = stations.xy[stations.crossing[stations.strip] == 0]
    reach = frame.strip_distance / 2 if plan.ties.layout == "schematic" else ROW_REACH * frame.footprint[1]
    area = frame.to_local(np.asarray(plan.area, float).reshape(-1, 2))
    extent = Extent(along.min(0) - [0.0, reach], along.max(0) + [0.0, reach], area)
    strips = int((stations.crossing == 0).sum())
    control, sigmas = _merged(plan, frame, [(_places(c, frame, extent, strips), c) for c in plan.control])
    ties = _tie_points(plan, frame, stations, rng)
    listed = () if isinstance(plan.check_points, int) else plan.check_points
    check = frame.to_local(np.asarray(listed, float).reshape(-1, 2))
    if plan.ties.layout == "schematic":
        return _snapped(frame, ties, control, sigmas, check)
    count = len(control) + len(check) + len(ties)
    known = np.full((count, 3), np.nan)
    known[: len(control)] = sigmas
    is_check = np.zeros(count, bool)
    is_check[len(control) : len(control) + len(check)] = True
    return GroundPoints(frame.to_object(np.concatenate([control, check, ties])), known, is_check)


def _places(control: ControlSet, frame: Frame, extent: Extent, strips: int) -> Float[np.ndarray, "control 2"]:
    """The points of one layout in local coordinates."""
    if control.layout == "points":
        return frame.to_local(np.asarray(control.points, float).reshape(-1, 2))
    if len(extent.area):
        return _in_area(control, frame, extent, strips)
    return _in_rectangle(control, frame, extent, strips)


def _in_area(control: ControlSet, frame: Frame, extent: Extent, strips: int) -> Float[np.ndarray, "control 2"]:
    """A layout in a polygon: its corners, its sides, or the inner points of the layout of its rectangle."""
    corners = extent.area
    if control.layout == "corners":
        return corners
    if control.layout != "perimeter":
        xy = _in_rectangle(control, frame, Extent(corners.min(0), corners.max(0), corners), strips)
        return xy[inside(corners, xy)]
    sides = np.roll(corners, -1, 0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    step = lengths.sum() / control.count if control.count else control.every * frame.base
    parts = np.maximum(1, np.round(lengths / step).astype(int))
    return np.concatenate(
        [a + side * np.arange(n)[:, None] / n for a, side, n in zip(corners, sides, parts, strict=True)]
    )


def inside(corners: Float[np.ndarray, "corner 2"], xy: Float[np.ndarray, "point 2"]) -> Bool[np.ndarray, " point"]:
    """Whether points are in a polygon: a line from each to the left crosses its sides an odd number of times."""
    found = np.zeros(len(xy), bool)
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        between = (a[1] > xy[:, 1]) != (b[1] > xy[:, 1])
        rise = b[1] - a[1] if b[1] != a[1] else 1.0
        found ^= between & (xy[:, 0] < a[0] + (xy[:, 1] - a[1]) / rise * (b[0] - a[0]))
    return found


def _in_rectangle(control: ControlSet, frame: Frame, extent: Extent, strips: int) -> Float[np.ndarray, "control 2"]:
    """A layout in a rectangle along the strips."""
    (x0, y0), (x1, y1), _ = extent
    columns = max(1, round((x1 - x0) / (control.every * frame.base))) + 1
    rows = max(1, round((y1 - y0) / (control.every * frame.base))) + 1
    if control.layout == "corners":
        columns = rows = 2
    elif control.layout == "chains":
        stations = np.linspace(0, (x1 - x0) / frame.base, columns)
        return _crossed(x0 + np.unique(np.round(stations)) * frame.base, np.linspace(y0, y1, strips + 1))
    elif control.layout == "rows":
        columns, rows = (2 if control.count is None else control.count), strips + 1
    elif control.count is not None:
        columns = rows = control.count
    x, y = np.linspace(x0, x1, columns), np.linspace(y0, y1, rows)
    xy = _crossed(x, y)
    if control.layout in ("grid", "rows"):
        return xy
    return xy[np.isin(xy[:, 0], (x0, x1)) | np.isin(xy[:, 1], (y0, y1))]


def _crossed(x: Float[np.ndarray, " column"], y: Float[np.ndarray, " row"]) -> Float[np.ndarray, "point 2"]:
    x, y = (grid.ravel() for grid in np.meshgrid(x, y, indexing="ij"))
    return np.c_[x, y]


def _merged(
    plan: FlightPlan, frame: Frame, sets: list[tuple[Float[np.ndarray, "_of_set 2"], ControlSet]]
) -> tuple[Float[np.ndarray, "control 2"], Float[np.ndarray, "control 3"]]:
    """Points of all layouts; points at the same position are merged, with the smaller sigmas."""
    found: dict[tuple[int, int], int] = {}
    places, sigmas = [], []
    for xy, control in sets:
        for place in xy:
            key = tuple(np.round(place / (SAME * frame.base)).astype(int).tolist())
            if key not in found:
                found[key] = len(places)
                places.append(place)
                sigmas.append(np.full(3, np.nan))
            number = found[key]
            sigmas[number] = np.fmin(sigmas[number], control.known)
    return np.array(places).reshape(-1, 2), np.array(sigmas).reshape(-1, 3)


def _snapped(
    frame: Frame,
    ties: Float[np.ndarray, "tie 2"],
    control: Float[np.ndarray, "control 2"],
    sigmas: Float[np.ndarray, "control 3"],
    check: Float[np.ndarray, "check 2"],
) -> GroundPoints:
    """Control and check points at the nearest tie points; control first."""
    known = np.full((len(ties), 3), np.nan)
    tree, is_check = KDTree(ties), np.zeros(len(ties), bool)
    if len(control):
        for place, sigma in zip(np.asarray(tree.query(control)[1]).tolist(), sigmas, strict=True):
            known[place] = np.fmin(known[place], sigma)
    if len(check):
        is_check[tree.query(check)[1]] = True
    order = np.argsort(np.isnan(known).all(1), kind="stable")
    return GroundPoints(frame.to_object(ties[order]), known[order], is_check[order])


def _tie_points(
    plan: FlightPlan, frame: Frame, stations: Stations, rng: np.random.Generator
) -> Float[np.ndarray, "tie 2"]:
    """Tie points over the area of all images, in local coordinates."""
    if plan.ties.layout == "schematic":
        return _schematic(plan, frame, stations)
    along, across = frame.footprint
    spacing = math.sqrt(along * across / plan.ties.points_per_image)
    half = np.array([along, across]) / 2
    if (stations.crossing == 1).any():
        half = np.full(2, half.max())
    low, high = stations.xy.min(0) - half, stations.xy.max(0) + half
    xy = _crossed(np.arange(low[0], high[0], spacing), np.arange(low[1], high[1], spacing))
    if plan.ties.layout == "random":
        return low + (high - low) * rng.uniform(size=xy.shape)
    if plan.ties.layout == "grid":
        return xy
    return xy + JITTER * spacing * rng.uniform(-1, 1, (2, len(xy))).T


def _schematic(plan: FlightPlan, frame: Frame, stations: Stations) -> Float[np.ndarray, "tie 2"]:
    """Columns at the stations; rows at the axes of the strips and between, half a strip distance beyond the outer."""
    along = stations.xy[stations.crossing[stations.strip] == 0]
    (x0, y0), (x1, y1) = along.min(0), along.max(0)
    columns, half, rows = round((x1 - x0) / frame.base) + 1, frame.strip_distance / 2, plan.ties.rows
    count = round((y1 - y0) / frame.strip_distance * rows) + rows + 1
    return _crossed(np.linspace(x0, x1, columns), np.linspace(y0 - half, y1 + half, count))
