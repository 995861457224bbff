"""Findings about object points with a hardly determined distance, and check points that contradict the precision."""

import numpy as np
from jaxtyping import Float

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import are, counted, figure, named
from jaxbundle.solve.adjustment import Adjustment

FAR = 0.3  # ratio of sd and distance from the camera: the rays of such a point are parallel within their errors
OFF = 4.0  # standard deviations of a difference at a check point; normal errors exceed it once in 16 thousand
ARBITRARY = ("minimal", "inner")  # datums without a relation to the coordinates of check points


def point_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about points with undetermined distance, and about check points."""
    return (*_far(adjustment), *_check_points(adjustment))


def _far(adjustment: Adjustment) -> list[Finding]:
    if adjustment.cofactors is None:
        return []
    structure, sd = adjustment.block.structure, np.asarray(adjustment.standard_deviations.object_points).max(1)
    distance = _distance_to_nearest_camera(adjustment)
    share = np.where(distance > 0, sd / np.where(distance > 0, distance, 1.0), 0.0)
    told = {subject for finding in adjustment.undetermined for subject in finding.subjects}
    far = np.flatnonzero(share > FAR)
    far = far[[Subject("points", (structure.point_names[p],)) not in told for p in far]]
    if not len(far):
        return []
    far, unit = far[np.argsort(-share[far], kind="stable")], structure.object_unit
    listed = named([f"{structure.point_names[p]} (sd {figure(sd[p])} {unit})" for p in far])
    what = (
        f"{counted(len(far), 'point')} {are(len(far))} known to no better than {FAR:.0%} of the distance from the"
        f" camera, as their rays are almost parallel: {listed}"
    )
    cure = "do not use these points: measure them on an image from a different position or drop them"
    subjects = tuple(Subject("points", (structure.point_names[p],)) for p in far)
    return [Finding(Kind.WEAK, what, cure, subjects, float(sd[far[0]]), unit)]


def _distance_to_nearest_camera(adjustment: Adjustment) -> Float[np.ndarray, " point"]:
    """Distance of each point from its camera; 0 for a point on no image."""
    structure = adjustment.block.structure
    points, centres = (
        np.asarray(x) for x in (adjustment.block.object_points, adjustment.block.exterior.projection_centre)
    )
    length = np.linalg.norm(points[structure.ray_point] - centres[structure.ray_image], axis=1)
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, structure.ray_point, length)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def check_point_ratios(adjustment: Adjustment) -> Float[np.ndarray, "check 3"]:
    """Differences divided by their standard deviations, including those of the known coordinates; NaN if unknown."""
    check = adjustment.block.structure.check_point
    known = np.asarray(adjustment.block.check_points.sigmas)
    sd = np.asarray(adjustment.standard_deviations.object_points)[check]
    both = np.hypot(sd, np.where(np.isfinite(known), known, 0.0))
    return np.asarray(adjustment.check_differences) / np.where(both > 0, both, np.nan)


def _check_points(adjustment: Adjustment) -> list[Finding]:
    structure = adjustment.block.structure
    if not len(structure.check_point):
        return []
    if structure.datum.kind in ARBITRARY:
        what = f"the datum is arbitrary ({structure.datum.kind}): differences at check points do not measure accuracy"
        return [Finding(Kind.CHECK_POINTS, what, "define the datum by control", grade=Severity.NOTE)]
    if adjustment.cofactors is None:
        return []
    ratios, differences = np.abs(check_point_ratios(adjustment)), np.asarray(adjustment.check_differences)
    worst = np.nan_to_num(ratios).max(1)
    off = np.flatnonzero(worst > OFF)
    if not len(off):
        return []
    off, unit = off[np.argsort(-worst[off], kind="stable")], structure.object_unit
    component = np.nan_to_num(ratios[off]).argmax(1)
    names = [structure.point_names[structure.check_point[c]] for c in off]
    listed = named(
        [
            f"{name} by {figure(float(differences[c, k]))} {unit} in {'XYZ'[k]} ({figure(float(ratios[c, k]))} sd)"
            for name, c, k in zip(names, off, component, strict=True)
        ]
    )
    differ = f"{len(off)} of {counted(len(worst), 'check point')} differ by more than {OFF:.0f} standard deviations"
    cure = (
        "check their coordinates and marks; if they are right the block is less accurate than its precision indicates"
    )
    subjects = tuple(Subject("control", (name,), "XYZ"[k]) for name, k in zip(names, component, strict=True))
    return [
        Finding(
            Kind.CHECK_POINTS, f"{differ}: {listed}", cure, subjects, float(differences[off[0], component[0]]), unit
        )
    ]
