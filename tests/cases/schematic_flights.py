"""Flights as the literature has them, and their predicted accuracy in units of sigma0 times the scale number."""

from typing import NamedTuple

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.planning.accuracy import judged_points
from jaxbundle.planning.flight import ControlSet, FlightPlan, Navigation, schematic
from jaxbundle.planning.prediction import predict
from jaxbundle.planning.simulation import simulate_flight

UNIT = schematic().sigma * schematic().scale_number
BASE, DISTANCE = 0.4 * 230e-3 * 1500 / 0.153, 0.8 * 230e-3 * 1500 / 0.153


class Precision(NamedTuple):
    """Standard deviations in sigma0 m, and who they belong to."""

    block: Block
    deviations: np.ndarray

    @property
    def rms_xy(self) -> float:
        """Root mean square of X and Y of the points where these are unknown."""
        return float(np.sqrt((self.deviations[self.block.structure.point_free[:, 0], :2] ** 2).mean()))

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square of X and Y, and of Z, of the points whose Z is unknown."""
        free = self.deviations[self.block.structure.point_free[:, 2]]
        return float(np.sqrt((free[:, :2] ** 2).mean())), float(np.sqrt((free[:, 2] ** 2).mean()))

    def at(self, x: float, y: float) -> np.ndarray:
        """Of the point nearest to a place."""
        points = np.asarray(self.block.object_points)
        return self.deviations[np.argmin(np.hypot(points[:, 0] - x, points[:, 1] - y))]


def precision_of(plan: FlightPlan) -> Precision:
    """The predicted precision of a flight."""
    truth = simulate_flight(plan).truth
    deviations = np.asarray(predict(truth).standard_deviations.object_points) / UNIT
    assert judged_points(truth).any()
    return Precision(truth, deviations)


def free_end(bases: int, overlap: float = 0.6) -> np.ndarray:
    """A strip with four fixed points in its first model: X, Y, Z on the axis at its last station."""
    base = BASE * (1 - overlap) / 0.4
    corners = tuple((x, y) for x in (0.0, base) for y in (-DISTANCE / 2, DISTANCE / 2))
    plan = schematic(images=bases + 1, forward_overlap=overlap, control=(ControlSet("points", points=corners),))
    return precision_of(plan).at(bases * base, 0.0)


def tied_middle(bases: int, pairs: bool) -> np.ndarray:
    """A strip between control at both ends: two XYZ points across each end, or one on the axis and one height."""
    ends = 0.0, bases * BASE
    if pairs:
        across = tuple((x, y) for x in ends for y in (-DISTANCE / 2, DISTANCE / 2))
        control = (ControlSet("points", points=across),)
    else:
        axis, side = tuple((x, 0.0) for x in ends), tuple((x, DISTANCE / 2) for x in ends)
        control = ControlSet("points", points=axis), ControlSet("points", kind="height", points=side)
    return precision_of(schematic(images=bases + 1, control=control)).at(bases * BASE / 2, 0.0)


def block_plan(strips: int, images: int, control: tuple[ControlSet, ...], **changes) -> FlightPlan:
    """A block with control at its tie points."""
    return schematic(strips=strips, images=images, control=control, **changes)


PERIMETERS = {
    "P1": ControlSet("perimeter", "plan", every=2),
    "P2": ControlSet("perimeter", "plan", count=5),
    "P3": ControlSet("perimeter", "plan", count=3),
    "P4": ControlSet("corners", "plan"),
}


def heights(every: float) -> ControlSet:
    """Chains of heights across the strips."""
    return ControlSet("chains", "height", every=every)


def heights_at(columns: tuple[int, ...], strips: int) -> ControlSet:
    """Chains of heights at some stations, with a point in every side lap."""
    rows = DISTANCE * (np.arange(strips + 1) - 0.5)
    return ControlSet("points", "height", points=tuple((c * BASE, float(y)) for c in columns for y in rows))


def gnss_plan(control: str, systematic: str) -> FlightPlan:
    """One of the blocks of Ackermann 1992, table 1: 6 x 21 photographs, centres observed with sigma0 times scale."""
    corners, ends = ControlSet("corners"), ControlSet("chains", "height", every=20)
    sets = {"c": (corners,), "a": (corners, ends)}
    if control == "b":
        y = DISTANCE * np.array([0.0, 5.0])
        inner = tuple((x, float(v)) for x in (0.0, 20 * BASE) for v in y)
        sets["b"] = corners, ControlSet("points", "height", points=inner)
    cross = (0.0, 1.0) if control == "b" else ()
    gnss = None if systematic == "absent" else Navigation((UNIT,) * 3, systematic)
    return schematic(strips=6, images=21, control=sets[control], cross_strips=cross, gnss=gnss)
