"""Control points that were marked by hand in photographs, and their marks remeasured by matching.

Marks of one point have errors of about a pixel each. One of them gives the template, which is matched in the other
images with the affine map of neighbouring tie points. The matches agree within a few hundredths of a pixel, so all of
them are then shifted by the mean difference of marks and matches: the point is the mean of what the marks meant.

The mean of n marks still has the error of a mark over sqrt(n), common to all images. Rays with the standard deviation
of one mark give their point just this precision, so the standard deviation of a ray remains that of a mark.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.imagery.match_types import Refusal
from jaxbundle.imagery.tracks import local_affine
from jaxbundle.imagery.window_pairs import PairTable, match_pairs
from jaxbundle.imagery.windows import GreyImages
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.io.formats.ground_control import GroundControl
from jaxbundle.measuring.measured_rays import COARSE, FINE, MeasuredRays

MARK_SIGMA = 1.0  # px: marks set by hand, and the definition of targets
HALF = 15  # px: windows of 31 x 31, larger than the centre of a painted cross; targets are flat
FROM_LEVEL = 1  # marks that are wrong by several pixels are found on this level
BY_HAND = -1  # status of a mark that was not remeasured


class ControlMarks(NamedTuple):
    """Control points and their marks in the photographs."""

    points: tuple[Known, ...]
    image: Int[np.ndarray, " mark"]
    """Index of the photograph."""
    point: Int[np.ndarray, " mark"]
    """Index among the points."""
    xy: Float[np.ndarray, "mark 2"]
    """px."""
    status: Int[np.ndarray, " mark"]
    """A `Refusal` as a number; -1 for a mark as it was set by hand."""
    findings: tuple[Finding, ...] = ()


def marks_of(control: GroundControl, names: Sequence[str]) -> ControlMarks:
    """The marks of control points in the photographs with these names.

    Raises: BlockError for a table without marks in the photographs.
    """
    numbers = {Path(name).stem.lower(): k for k, name in enumerate(names)} | {name: k for k, name in enumerate(names)}
    found = [(numbers.get(image, numbers.get(Path(image).stem.lower())), *row) for row, image in _rows(control)]
    known = [row for row in found if row[0] is not None]
    if not known:
        what = f"none of its {len(found)} marks is in one of the photographs"
        cure = "give gcp_list.txt with rows x y z u v image [name], and the names of the photographs"
        raise BlockError([Problem(what, cure, "control")])
    used = {name for _, name, _, _ in known}
    points = tuple(point for point in control.points if point.name in used)
    position = {point.name: k for k, point in enumerate(points)}
    findings = list(control.findings)
    if len(known) < len(found):
        what = f"{len(found) - len(known)} of {len(found)} marks of control are in other photographs"
        findings.append(Finding(Kind.NOT_USED, what, grade=Severity.NOTE))
    return ControlMarks(
        points,
        np.array([k for k, *_ in known], int),
        np.array([position[name] for _, name, _, _ in known], int),
        np.array([[x, y] for *_, x, y in known], float),
        np.full(len(known), BY_HAND),
        tuple(findings),
    )


def _rows(control: GroundControl) -> list[tuple[tuple[str, float, float], str]]:
    return [((point, x, y), image) for point, image, x, y in control.rays]


def remeasured(
    images: GreyImages, marks: ControlMarks, rays: MeasuredRays, sizes: Sequence[tuple[int, int]]
) -> ControlMarks:
    """The marks remeasured by matching; a mark whose match is refused is unchanged.

    Args:
        images: the pyramids by the indices of the photographs.
        marks: marks set by hand.
        rays: tie points around the marks.
        sizes: rows and columns of the photographs.
    """
    template, other = _pairs(marks, sizes)
    affine = [_affine(rays, marks, one, two) for one, two in zip(template.tolist(), other.tolist(), strict=True)]
    pairs = PairTable(
        marks.image[template],
        marks.image[other],
        marks.xy[template],
        marks.xy[other],
        np.array(affine).reshape(-1, 2, 2),
    )
    matches = None
    for level in range(FROM_LEVEL, -1, -1):
        matches = match_pairs(images, pairs, level, COARSE if level else FINE, HALF)
        pairs = pairs._replace(predicted=matches.position)
    assert matches is not None, "level 0 exists"
    good, xy, status = matches.matched, marks.xy.copy(), marks.status.copy()
    status[other] = matches.status
    differences = []
    for one in np.unique(template[good]):
        own = np.flatnonzero(good & (template == one))
        off = marks.xy[other[own]] - matches.position[own]
        in_template = np.linalg.solve(matches.affine[own], off[..., None])[..., 0]
        mean = in_template.sum(0) / (len(own) + 1)  # the mark of the template agrees with itself
        xy[one] += mean
        xy[other[own]] = matches.position[own] + matches.affine[own] @ mean
        status[one] = Refusal.MATCHED
        differences.append(np.concatenate([in_template, np.zeros((1, 2))]) - mean)
    return marks._replace(xy=xy, status=status, findings=(*marks.findings, _told(status, differences)))


def _pairs(
    marks: ControlMarks, sizes: Sequence[tuple[int, int]]
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """For each point the mark nearest to the centre of its photograph, the template, with each of the others."""
    middle = np.array([[columns / 2, rows / 2] for rows, columns in sizes])[marks.image]
    away = ((marks.xy - middle) ** 2).sum(1)
    template, other = [], []
    for point in range(len(marks.points)):
        own = np.flatnonzero(marks.point == point)
        first = own[np.argmin(away[own])]
        rest = [int(k) for k in own if marks.image[k] != marks.image[first]]
        template += [int(first)] * len(rest)
        other += rest
    return np.array(template, int), np.array(other, int)


def _affine(rays: MeasuredRays, marks: ControlMarks, template: int, other: int) -> Float[np.ndarray, "2 2"]:
    """Derivatives of coordinates in the other image with respect to those of the template, from tie points around."""
    one, two = (np.flatnonzero(rays.image == marks.image[k]) for k in (template, other))
    _, i, j = np.intersect1d(rays.point[one], rays.point[two], return_indices=True)
    return local_affine(rays.xy[one[i]], rays.xy[two[j]], marks.xy[template][None])[0]


def _told(status: Int[np.ndarray, " mark"], differences: Sequence[Float[np.ndarray, "_mark 2"]]) -> Finding:
    measured = int((status == Refusal.MATCHED).sum())
    what = f"{measured} of {len(status)} marks of control were remeasured by matching"
    if differences:
        rms = float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))
        what += f"; marks and matches differ by {rms:.2f} px (rms)"
    cure = "check the others in the photographs" if measured < len(status) else ""
    return Finding(Kind.INFORMATION, what, cure)
