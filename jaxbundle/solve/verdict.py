"""The verdict on an adjustment: problems that forbid its use, independent of its residuals.

    behind the cameras   the image equation is valid for lines, not for rays: mirrored solutions fit as well
    below the terrain    a camera that looks down and lies below the points it sees
    not converged        by the status of the iterations
    sigma0               residuals so much larger than their sigmas that statements about precision are meaningless

All checks run on the host and use only adjusted values, so an adjustment without standard deviations is checked
in the same way.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.depths import behind, viewing_directions
from jaxbundle.block.findings import Finding, Kind, Severity, Subject, in_order
from jaxbundle.solve.adjustment import Adjustment, Status

NAMED = 5  # maximum number of examples in one sentence
FEW_BEHIND = 0.002  # share of the rays: Ladybug-49 of the BAL data has 31 of 31 843 behind their cameras
MANY_BEHIND = 0.01  # share of the rays: above this more than single points are wrong
MIRRORED = 0.9  # share of the rays: the block as a whole is on the wrong side
VERTICAL = 0.7  # cosine: cameras whose axis is within 45 degrees of the vertical
BEYOND_USE = 10.0  # sigma0: sigmas are wrong by a factor of ten only if a unit or the model of the block is wrong
CURES = {
    Status.MAXIMUM_ITERATIONS: "allow more iterations, or give better approximate values",
    Status.SINGULAR: "fix the undetermined unknowns, or use the Levenberg-Marquardt method",
    Status.DIVERGED: "give better approximate values, or use the Levenberg-Marquardt method",
    Status.STALLED: "search for gross errors and for hardly determined unknowns",
    Status.CREEPING: "find the unknowns with large standard deviations, and fix them or add observations",
    Status.INTERRUPTED: "start again from the adjusted values",
}
SIDE = (
    "check the direction of the y axis (px: down, mm: up), whether the image coordinates are mirrored, and on which"
    " side of the points the approximate projection centres lie"
)


def with_verdict(adjustment: Adjustment) -> Adjustment:
    """A concrete adjustment with additional findings that forbid its use."""
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
    what = f"sigma0 is {sigma0:.4g}: the residuals are on average {sigma0:.3g} times their sigmas"
    cure = (
        "check units and sigmas, then search for gross errors; the standard deviations of this result are meaningless"
    )
    return [Finding(Kind.SIGMA0, what, cure, size=sigma0)]


def _sides(block: Block) -> list[Finding]:
    """Findings about points behind cameras and stations below the terrain."""
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
    """Images with points behind them, in decreasing order of the share of rays."""
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
    cure = (
        "their coordinates are not usable: measure them on images from other positions, correct their rays or drop them"
    )
    return Finding(
        Kind.BEHIND, what, cure, subjects, len(points), grade=Severity.NOTE if share <= FEW_BEHIND else Severity.CHECK
    )


def _below(block: Block) -> list[Finding]:
    """The finding about cameras that look down but are below their points."""
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
        f"{int(below.sum())} of {len(below)} stations lie below the points that they look down on, image"
        f" {structure.image_names[order[0]]} by {depth[order[0]]:.4g} {unit}"
    )
    cure = "check the sign of the heights and the direction of the y axis of the image coordinates"
    return [Finding(Kind.BELOW_TERRAIN, what, cure, subjects, float(depth[order[0]]), unit)]


def _terrain(block: Block) -> Float[np.ndarray, " image"]:
    """Median height of the points of each image; minus infinity for an image without points."""
    structure = block.structure
    order = np.lexsort((np.asarray(block.object_points)[structure.ray_point, 2], structure.ray_image))
    heights = np.asarray(block.object_points)[structure.ray_point[order], 2]
    count = np.bincount(structure.ray_image, minlength=len(structure.image_names))
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, max(len(heights) - 1, 0))
    return np.where(count > 0, heights[middle], -np.inf)
