"""Stations of a flight: parallel strips, cross strips, coverage of an area.

All positions are computed in a local frame, x along the first heading, and rotated to the object system at the end.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.planning.flight import FlightPlan


class Frame(NamedTuple):
    """The local frame of a flight and its dimensions."""

    angle: float
    """From the X axis to the local x axis, counter-clockwise, in radians."""
    origin: tuple[float, float]
    base: float
    """Distance of stations in a strip, object unit."""
    strip_distance: float
    footprint: tuple[float, float]
    """Size of an image on the mean ground, along and across the strip."""

    def to_object(self, xy: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Converts local coordinates to object coordinates."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        if self.angle == 0 and self.origin == (0.0, 0.0):
            return xy
        return xy @ np.array([[c, s], [-s, c]]) + self.origin

    def to_local(self, xy: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Converts object coordinates to local coordinates."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return (xy - np.asarray(self.origin)) @ np.array([[c, -s], [s, c]])


class Stations(NamedTuple):
    """Nominal stations in the order of flight, in local coordinates."""

    xy: Float[np.ndarray, "image 2"]
    kappa: Float[np.ndarray, " image"]
    """Local heading: 0 along the first heading."""
    strip: Int[np.ndarray, " image"]
    crossing: Int[np.ndarray, " strip"]
    """0 for strips along the first heading, 1 for cross strips and other headings."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of strip and number in the strip, such as "1_01"."""
        counts = np.bincount(self.strip)
        digits = max(2, len(str(counts.max())))
        return tuple(f"{s + 1}_{k + 1:0{digits}d}" for s, count in enumerate(counts) for k in range(count))

    @property
    def time(self) -> Float[np.ndarray, " image"]:
        """Number of the exposure in the flight, relative to the mean."""
        return np.arange(len(self.xy)) - (len(self.xy) - 1) / 2


def frame_of(plan: FlightPlan) -> Frame:
    """The local frame along the first heading."""
    scale = plan.height / plan.camera.principal_distance
    along, across = scale * plan.camera.width, scale * plan.camera.height
    angle = math.pi / 2 - plan.headings[0]
    base, distance = (1 - plan.forward_overlap) * along, (1 - plan.side_overlap) * across
    origin = plan.area[0] if plan.area else plan.origin
    return Frame(angle, origin, base, distance, (along, across))


def stations_of(plan: FlightPlan, frame: Frame) -> Stations:
    """All stations of a flight."""
    strips = _covering(plan, frame) if plan.area else _rectangle(plan, frame)
    along = np.concatenate([xy for xy, _ in strips])
    cross = _cross_strips(plan, frame, along)
    every = [*strips, *cross]
    numbers = np.repeat(np.arange(len(every)), [len(xy) for xy, _ in every])
    kappa = np.repeat([angle for _, angle in every], [len(xy) for xy, _ in every])
    crossing = np.array([int(abs(math.sin(angle)) > 1e-9) for _, angle in every])
    return Stations(np.concatenate([xy for xy, _ in every]), kappa, numbers, crossing)


Strip = tuple[Float[np.ndarray, "station 2"], float]


def _flown(xy: Float[np.ndarray, "station 2"], angle: float, number: int, plan: FlightPlan) -> Strip:
    """One strip; each second strip is flown in the opposite direction."""
    if plan.back_and_forth and number % 2:
        return xy[::-1], angle + math.pi
    return xy, angle


def _rectangle(plan: FlightPlan, frame: Frame) -> list[Strip]:
    x = np.arange(plan.images) * frame.base
    return [
        _flown(np.c_[x, np.full(plan.images, strip * frame.strip_distance)], 0.0, strip, plan)
        for strip in range(plan.strips)
    ]


def _cross_strips(plan: FlightPlan, frame: Frame, along: Float[np.ndarray, "image 2"]) -> list[Strip]:
    """A cross strip from half a strip distance outside the first axis to half outside the last one."""
    half, base = frame.strip_distance / 2, frame.base
    low, high = along.min(0), along.max(0)
    y = np.arange(low[1] - half, high[1] + half + 1e-9 * base, base)
    return [
        _flown(np.c_[np.full(len(y), low[0] + share * (high[0] - low[0])), y], math.pi / 2, number, plan)
        for number, share in enumerate(plan.cross_strips)
    ]


def _covering(plan: FlightPlan, frame: Frame) -> list[Strip]:
    """Strips along all headings that cover the area: each position is on at least two images of a strip."""
    found = []
    for heading in plan.headings:
        turned = frame._replace(angle=math.pi / 2 - heading)
        corners = turned.to_local(np.asarray(plan.area, float))
        across = frame.footprint[1]
        low, high = corners[:, 1].min(), corners[:, 1].max()
        count = max(1, math.ceil((high - low - across) / frame.strip_distance - 1e-9) + 1)
        middle = (low + high) / 2 - (count - 1) / 2 * frame.strip_distance
        for strip in range(count):
            y = middle + strip * frame.strip_distance
            reach = _reach(corners, y - across / 2, y + across / 2)
            images = max(2, math.ceil((reach[1] - reach[0]) / frame.base - 1e-9) + 1)
            x = sum(reach) / 2 + (np.arange(images) - (images - 1) / 2) * frame.base
            xy = frame.to_local(turned.to_object(np.c_[x, np.full(images, y)]))
            found.append(_flown(xy, turned.angle - frame.angle, strip, plan))
    return found


def _reach(corners: Float[np.ndarray, "corner 2"], low: float, high: float) -> tuple[float, float]:
    """Minimum and maximum x of a polygon between two lines of equal y."""
    inside = [corners[(corners[:, 1] >= low) & (corners[:, 1] <= high), 0]]
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        for y in (low, high):
            if (a[1] - y) * (b[1] - y) < 0:
                inside.append(np.array([a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])]))
    x = np.concatenate(inside)
    if not len(x):
        x = corners[:, 0]
    return float(x.min()), float(x.max())
