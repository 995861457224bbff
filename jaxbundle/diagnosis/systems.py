"""Comparing control with the intersections of its rays at the approximate orientations.

Approximate orientations may be rough. Therefore differences are compared with the depth of the scene, and those of
one point with those of all others, never with a sigma.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import counted, named
from jaxbundle.orientation.sight import Sight, intersected, medians, only, photo_vectors, relative_off

LEAST = 3  # minimum number of control points with at least two rays
NEAR, FAR = (
    0.1,
    1.0,
)  # shares of the depth: a cause is searched; control is in another system
ROUGH = 0.3  # share of the depth: errors of rough orientations
AGREES = 0.1  # maximum share of the differences that remains after a named cause
OUTLYING = 8.0  # angle, times the median of the others: in rough starts the maximum of twelve is four times the median
DISTANT = 2.5  # distance, times the median of the others: weak intersections scatter in depth
SEEN, SEEN_SINGLE = 0.1, 0.3  # angle in image fields: of all control, and of a single named point
PAIR = 0.2  # maximum share of the difference that remains when names or columns of single points are exchanged
US_FOOT, FOOT = 1200 / 3937, 0.3048


class _Control(NamedTuple):
    """Control points with at least two rays: given and intersected coordinates, angles between them in image fields."""

    point: Int[np.ndarray, " control"]
    given: Float[np.ndarray, "control 3"]
    met: Float[np.ndarray, "control 3"]
    seen: Float[np.ndarray, " control"]
    depth: float

    @property
    def off(self) -> Float[np.ndarray, " control"]:
        return np.linalg.norm(self.given - self.met, axis=1)


def control_findings(block: Block, sight: Sight) -> list[Finding]:
    """Findings about control in another system than the approximate orientations, and about single control points."""
    control = _control(sight)
    same = _coinciding(block, sight)
    if len(control.point) < LEAST:
        return same
    if np.median(control.off) > NEAR * control.depth and np.median(control.seen) > SEEN:
        whole = _whole(block, control)
        if whole:
            return [*whole, *same]
    return [*_single(block, control), *same]


def _control(sight: Sight) -> _Control:
    sight = only(sight, sight.is_known[sight.point])
    meet, count = intersected(sight), len(sight.points)
    chosen = np.flatnonzero(sight.is_known & meet.in_front)
    seen = medians(relative_off(sight, sight.known), sight.point, count)
    depth = np.abs(photo_vectors(sight, meet.points)[meet.in_front[sight.point], 2])
    typical = float(np.median(depth)) if len(depth) else np.inf
    return _Control(chosen, sight.known[chosen], meet.points[chosen], seen[chosen], typical)


def _whole(block: Block, control: _Control) -> list[Finding]:
    """The finding that all control is in another system."""
    s = block.structure
    given, met, off = control.given, control.met, np.median(control.off)
    what = f"the {len(given)} control points lie {off:.4g} {s.object_unit} (median) from the intersection of their rays"
    subjects = tuple(Subject("control", (s.point_names[k],)) for k in control.point)
    for words, cure, changed in _changes(given):
        rest = np.median(np.linalg.norm(changed - met, axis=1))
        if rest <= AGREES * off and rest <= ROUGH * control.depth:
            what += f"; {words} it would be {rest:.4g} {s.object_unit}"
            return [Finding(Kind.CONTROL_SYSTEM, what, cure, subjects, float(off), s.object_unit)]
    if off <= FAR * control.depth:
        return []
    if _is_geographic(given) and not _is_geographic(met):
        cure = "longitude and latitude in degrees? give control in metres in the system of the images"
        return [Finding(Kind.CONTROL_SYSTEM, what, cure, subjects, float(off), s.object_unit)]
    shift = np.median(met - given, axis=0)
    rest = np.median(np.linalg.norm(given + shift - met, axis=1))
    grade = None
    cure = "give control, images and points in one coordinate system"
    if rest <= AGREES * off and rest <= ROUGH * control.depth:
        by = ", ".join(f"{x:.6g}" for x in shift)
        what += f"; with a shift of ({by}) it would be {rest:.4g} {s.object_unit}"
        cure, grade = "the origins differ: give control, images and points in one coordinate system", Severity.CHECK
    return [Finding(Kind.CONTROL_SYSTEM, what, cure, subjects, float(off), s.object_unit, grade)]


def _changes(given: Float[np.ndarray, "control 3"]) -> list[tuple[str, str, Float[np.ndarray, "control 3"]]]:
    return [
        ("with X and Y exchanged", "exchange X and Y of the control points", given[:, [1, 0, 2]]),
        ("divided by 1000", "control in mm? give it in the unit of the images", given / 1000),
        ("times 1000", "control in km, or images in mm? give both in one unit", given * 1000),
        ("as feet", "control in feet? give it in metres", given * FOOT),
        ("as US survey feet", "control in US survey feet? give it in metres", given * US_FOOT),
        ("with metres as feet", "images in feet? give them in metres", given / FOOT),
        ("with X and Y exchanged and divided by 1000", "exchange X and Y, and give metres", given[:, [1, 0, 2]] / 1000),
        ("with Y of opposite sign", "a left-handed system? give Y to the north", given * [1, -1, 1]),
        ("with Z of opposite sign", "depths for heights? give Z upwards", given * [1, 1, -1]),
    ]


def _is_geographic(coordinates: Float[np.ndarray, "control 3"]) -> bool:
    small = (np.abs(coordinates[:, 0]) <= 360) & (np.abs(coordinates[:, 1]) <= 360)
    return bool(small.all() and (np.ptp(coordinates[:, :2], axis=0) < 5).all())


def _single(block: Block, control: _Control) -> list[Finding]:
    """Findings about points that are far off while the others agree, the worst first; one finding for a pair."""
    s, off = block.structure, control.off
    limits = ((off, DISTANT), (control.seen, OUTLYING))
    suspects = [
        k
        for k in np.argsort(-off).tolist()
        if control.seen[k] > SEEN_SINGLE and all(v[k] > f * _typical(v, k) for v, f in limits)
    ]
    if 2 * len(suspects) >= len(off):
        return []
    findings, done = [], set()
    for k in suspects:
        if k in done:
            continue
        name, typical = s.point_names[control.point[k]], _typical(off, k)
        partner = next((j for j in suspects if j != k and j not in done and _exchanged(control, k, j)), None)
        what = (
            f"control point {name} lies {off[k]:.4g} {s.object_unit} from the intersection of its rays, the others"
            f" {typical:.3g} {s.object_unit} (median)"
        )
        subjects, cure = (Subject("control", (name,)),), "check its coordinates and its name"
        if partner is not None:
            other = s.point_names[control.point[partner]]
            done.add(partner)
            what = (
                f"control points {name} and {other} lie {off[k]:.4g} and {off[partner]:.4g} {s.object_unit} from"
                " intersections of their rays; with their names exchanged they would agree"
            )
            subjects, cure = (*subjects, Subject("control", (other,))), "exchange the two names"
        elif _agrees(float(np.linalg.norm(control.given[k][[1, 0, 2]] - control.met[k])), float(off[k]), typical):
            what, cure = f"{what}; with X and Y exchanged it would agree", "exchange its X and Y"
        findings.append(
            Finding(Kind.CONTROL_SYSTEM, what, cure, subjects, float(off[k]), s.object_unit, Severity.CHECK)
        )
    return findings


def _typical(values: Float[np.ndarray, " control"], k: int) -> float:
    """Median of the best two thirds of the others: up to a third of the points may be wrong."""
    others = np.sort(np.delete(values, k))
    return float(np.median(others[: -(-2 * len(others) // 3)]))


def _agrees(rest: float, off: float, typical: float) -> bool:
    """Whether the remaining difference after a cause is small, or similar to that of the others."""
    return rest <= max(PAIR * off, min(2 * typical, 0.5 * off))


def _exchanged(control: _Control, k: int, j: int) -> bool:
    near = [float(np.linalg.norm(control.given[a] - control.met[b])) for a, b in ((k, j), (j, k))]
    typical = _typical(control.off, k)
    return _agrees(near[0], float(control.off[j]), typical) and _agrees(near[1], float(control.off[k]), typical)


def _coinciding(block: Block, sight: Sight) -> list[Finding]:
    """The finding about control points with equal coordinates."""
    known = np.flatnonzero(sight.is_known)
    if not len(known):
        return []
    _, inverse, count = np.unique(sight.known[known], axis=0, return_inverse=True, return_counts=True)
    findings = []
    for k in np.flatnonzero(count > 1):
        names = [block.structure.point_names[p] for p in known[inverse.ravel() == k]]
        what = f"{counted(len(names), 'control point')} have the same coordinates: {named(names)}"
        subjects = tuple(Subject("control", (name,)) for name in names)
        findings.append(Finding(Kind.CONTROL_SYSTEM, what, "correct their coordinates", subjects, grade=Severity.CHECK))
    return findings
