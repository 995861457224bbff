"""The verdict on an adjustment: what forbids its use, whatever its residuals say.

    behind the cameras   the image equation holds for lines, not for rays: its mirrored solutions fit as well
    below the terrain    a camera that looks down and lies below the points it sees
    not converged        by the status of the iterations
    sigma0               residuals so far beyond their sigmas that no statement about precision is left

Everything here is looked at on the host, from the adjusted values alone, so that an adjustment without standard
deviations is judged with the same care.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.depths import behind, viewing_directions
from jaxbundle.block.findings import Finding, Kind, Severity, Subject, in_order
from jaxbundle.solve.adjustment import Adjustment, Status

NAMED = 5  # examples in one sentence
FEW_BEHIND = 0.002  # share of the rays: Ladybug-49 of the BAL data has 31 of 31 843 behind their cameras
MANY_BEHIND = 0.01  # beyond, more than single points are wrong
MIRRORED = 0.9  # share of the rays: the block as a whole is on the wrong side
VERTICAL = 0.7  # cosine: cameras whose axis is within 45 degrees of the vertical
BEYOND_USE = 10.0  # sigma0: sigmas are ten times wrong only where a unit or the model of the block is
CURES = {
    Status.MAXIMUM_ITERATIONS: "allow more iterations, or give better approximate values",
    Status.SINGULAR: "hold what the observations do not determine, or use the Levenberg-Marquardt method",
    Status.DIVERGED: "give better approximate values, or use the Levenberg-Marquardt method",
    Status.STALLED: "look for gross errors and for unknowns that are hardly determined",
    Status.CREEPING: "look which standard deviations are large, and observe or hold what they belong to",
    Status.INTERRUPTED: "start again from the adjusted values",
}
SIDE = (
    "check the direction of the y axis (px: down, mm: up), whether the image coordinates are mirrored, and on which"
    " side of the points the approximate projection centres lie"
)


def with_verdict(adjustment: Adjustment) -> Adjustment:
    """A concrete adjustment with what forbids its use among its findings."""
    found = [*adjustment.findings, *_status(adjustment), *_sides(adjustment.block), *_sigma0(adjustment)]
    return dataclasses.replace(adjustment, findings=in_order(found))


def _status(adjustment: Adjustment) -> list[Finding]:
    status = adjustment.status
    if status is Status.CONVERGED:
        return []
    return [Finding(Kind.NOT_CONVERGED, f"the adjustment {status.words}", CURES[status])]


def _sigma0(adjustment: Adjustment) -> list[Finding]:
    sigma0 = float(adjustment.sigma0)
    if not sigma0 > BEYOND_USE:
        return []
    what = f"sigma0 is {sigma0:.4g}: the residuals are on average {sigma0:.3g} times as large as their sigmas"
    cure = "check units and sigmas, then look for gross errors; no standard deviation of this result means anything"
    return [Finding(Kind.SIGMA0, what, cure, size=sigma0)]


def _sides(block: Block) -> list[Finding]:
    """Points behind cameras and stations below the terrain."""
    wrong = behind(block)
    if not wrong.any():
        return []
    share, count = float(wrong.mean()), int(wrong.sum())
    images = _images(block, wrong)
    if share >= MIRRORED:
        rays = f"all {count} rays" if count == len(wrong) else f"{count} of {len(wrong)} rays"
        what = f"the solution is mirrored: {rays} have their point behind the camera"
        found = Finding(Kind.MIRRORED, what, SIDE, images, count)
    elif share > MANY_BEHIND:
        worst = ", ".join(subject.names[0] for subject in images[:NAMED])
        what = f"{count} of {len(wrong)} rays have their point behind the camera, most of them on images {worst}"
        found = Finding(Kind.BEHIND, what, SIDE, images, count)
    else:
        found = _single_points(block, wrong, share)
    return [found, *_below(block)]


def _images(block: Block, wrong: Bool[np.ndarray, " ray"]) -> tuple[Subject, ...]:
    """Images with rays whose point lies behind, those with the largest share first."""
    structure = block.structure
    count = len(structure.image_names)
    bad, rays = (
        np.bincount(structure.ray_image[wrong], minlength=count),
        np.bincount(structure.ray_image, minlength=count),
    )
    share = bad / np.maximum(rays, 1)
    order = np.argsort(-share, kind="stable")
    return tuple(Subject("images", (structure.image_names[i],)) for i in order if bad[i])


def _single_points(block: Block, wrong: Bool[np.ndarray, " ray"], share: float) -> Finding:
    structure = block.structure
    points = np.unique(structure.ray_point[wrong])
    subjects = tuple(Subject("points", (structure.point_names[p],)) for p in points)
    listed = ", ".join(subject.names[0] for subject in subjects[:NAMED])
    more = f" and {len(points) - NAMED} more" if len(points) > NAMED else ""
    what = f"{int(wrong.sum())} of {len(wrong)} rays have their point behind the camera: points {listed}{more}"
    cure = "their coordinates are not usable: measure them on images from elsewhere, correct their rays or drop them"
    return Finding(
        Kind.BEHIND, what, cure, subjects, len(points), grade=Severity.NOTE if share <= FEW_BEHIND else Severity.CHECK
    )


def _below(block: Block) -> list[Finding]:
    """Cameras that look down from below the points they see."""
    structure = block.structure
    heights = np.asarray(block.exterior.projection_centre)[:, 2]
    terrain = _terrain(block)
    below = (viewing_directions(block)[:, 2] < -VERTICAL) & (heights < terrain)
    if 2 * below.sum() <= len(below):
        return []
    depth = np.where(below, terrain - heights, 0.0)
    order = np.argsort(-depth, kind="stable")[: int(below.sum())]
    subjects = tuple(Subject("images", (structure.image_names[i],), "Z0") for i in order)
    unit = structure.object_unit
    what = (
        f"{int(below.sum())} of {len(below)} stations lie below the points they look down on, image"
        f" {structure.image_names[order[0]]} by {depth[order[0]]:.4g} {unit}"
    )
    cure = "check the sign of the heights and the direction of the y axis of the image coordinates"
    return [Finding(Kind.BELOW_TERRAIN, what, cure, subjects, float(depth[order[0]]), unit)]


def _terrain(block: Block) -> Float[np.ndarray, " image"]:
    """Median height of the points that each image sees; infinitely low where it sees none."""
    structure = block.structure
    order = np.lexsort((np.asarray(block.object_points)[structure.ray_point, 2], structure.ray_image))
    heights = np.asarray(block.object_points)[structure.ray_point[order], 2]
    count = np.bincount(structure.ray_image, minlength=len(structure.image_names))
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, max(len(heights) - 1, 0))
    return np.where(count > 0, heights[middle], -np.inf)
