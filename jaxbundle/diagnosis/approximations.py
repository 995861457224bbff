"""Checking approximate orientations against the points: absurd values and confusions.

The reference are the points of a checked start. A confusion (kappa rotated, angles in another unit, Z0 with opposite
sign) is named for all images that it explains, if it fits each of them far better than the given values.
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import counted, named
from jaxbundle.orientation.alternatives import (
    PLAIN,
    Given,
    explains,
    left,
    mirrored,
    of_attitudes,
    of_both,
    of_stations,
)
from jaxbundle.orientation.checked_start import CheckedStart
from jaxbundle.orientation.sight import HALF, Sight, mostly_beyond, off, only, relative_off

MOST = 0.5  # an image is named if the point is behind it for this share of its rays
FEW_BEHIND = 0.01  # share of all rays: real blocks have some distant or wrong points behind images
ALIKE = 2.0  # times the angular misfit of the best cause: up to this, causes are named together
MAX_CAUSES = 2
ONE_PLACE = 1e-9  # tolerance of the coordinates
MIN_KNOWN = 4  # minimum number of rays of control to detect a mirrored system without other points


def mirrored_finding(block: Block, sight: Sight) -> Finding | None:
    """The finding about mirrored image coordinates, or a left-handed object system."""
    found = mirrored(sight)
    known = sight.is_known
    if found is None and known[sight.point].sum() >= MIN_KNOWN and not known.all():
        alone = only(sight, known[sight.point])  # other points may be intersected in a mirrored system
        found = mirrored(alone)
    if found is None:
        return None
    now, then = np.nanmedian(left(sight)), np.nanmedian(left(found.sight))
    images = tuple(Subject("images", (name,)) for name in block.structure.image_names)
    of_all = f"of all {len(images)} images"
    if found.of == "object":
        what = f"the rays {of_all} do not agree with their points; they would with {found.words}"
        cure = "give coordinates in a right-handed system: X east, Y north, Z up"
        return Finding(Kind.CONTROL_SYSTEM, what, cure, images, float(now / max(then, 1e-12)))
    what = f"the rays {of_all} do not agree with their points; they would with {found.words} in the images"
    cure = {
        "y": "px need y down from the top left corner, mm need y up: change the sign of y",
        "x": "the photos are read from the wrong side: change the sign of x",
    }.get(found.component, "exchange the columns x and y of rays.csv")
    subjects = (Subject("rays", (), "" if " " in found.component else found.component), *images)
    return Finding(Kind.FORMAT, what, cure, subjects)


def start_findings(block: Block, given: Sight, checked: CheckedStart, told_points: set[str]) -> list[Finding]:
    """Findings about absurd approximate values of the images, with the likely cause.

    `told_points`: control that was already reported as wrong; its rays are not used.
    """
    reference = checked.sight
    sight = given._replace(points=reference.points)
    s = block.structure
    same = _one_place(block)
    findings = [*same]
    if not same:
        for words, images, component in _confusions(block, sight):
            findings.append(_confusion(block, words, images, component))
    remaining = checked.suspects
    if remaining.any() and not same:
        findings.append(_unexplained(block, reference, remaining))
    believed = (
        ~np.isin(np.array(s.point_names), list(told_points)) if told_points else np.ones(len(s.point_names), bool)
    )
    return findings if same else [*findings, *_behind(block, reference, believed[reference.point])]


def _confusions(block: Block, sight: Sight) -> list[tuple[str, Bool[np.ndarray, " image"], str]]:
    """Alternatives that explain images, in decreasing order of the number of images."""
    s = block.structure
    q = relative_off(sight, sight.believed)
    open_images = mostly_beyond(q, PLAIN, sight.image, len(s.image_names))
    if not open_images.any():
        return []
    now = left(sight)
    given = Given(sight, np.asarray(block.exterior.angles), s.rotation_system, s.angle_unit)
    alternatives = [*of_attitudes(given), *of_stations(sight), *of_both(sight)]
    rest = [left(alternative.sight) for alternative in alternatives]
    found = []
    while open_images.any():
        explained = [explains(r, now) & open_images for r in rest]
        most = max(e.sum() for e in explained)
        if not most:
            break
        equal = [k for k, e in enumerate(explained) if e.sum() == most]
        usual = [k for k in equal if alternatives[k].usual] or equal
        least = {k: _median(rest[k], explained[k]) for k in usual}
        best = min(usual, key=least.__getitem__)
        alike = [k for k in usual if least[k] <= ALIKE * least[best]]  # a rough start cannot distinguish them
        words = " or ".join(alternatives[k].words for k in alike[:MAX_CAUSES])
        found.append((words, explained[best], alternatives[best].component))
        open_images = open_images & ~explained[best]
    return found


def _median(values: Float[np.ndarray, " image"], chosen: Bool[np.ndarray, " image"]) -> float:
    return float(np.nan_to_num(np.nanmedian(values[chosen]), nan=np.inf))


def _whom(block: Block, images: Bool[np.ndarray, " image"]) -> str:
    names = [block.structure.image_names[k] for k in np.flatnonzero(images)]
    if len(names) == len(images) and len(names) > 1:
        return f"all {len(names)} images"
    return f"image {names[0]}" if len(names) == 1 else f"{counted(len(names), 'image')} ({named(names)})"


def _subjects(block: Block, images: Bool[np.ndarray, " image"], component: str = "") -> tuple[Subject, ...]:
    return tuple(Subject("images", (block.structure.image_names[k],), component) for k in np.flatnonzero(images))


def _confusion(block: Block, words: str, images: Bool[np.ndarray, " image"], component: str) -> Finding:
    what = f"{_whom(block, images)}: the approximate orientation does not agree with the points; it would with {words}"
    return Finding(Kind.START, what, "correct images.csv", _subjects(block, images, component))


def _unexplained(block: Block, sight: Sight, images: Bool[np.ndarray, " image"]) -> Finding:
    angles = np.degrees(off(sight, sight.believed))
    worst = np.nan_to_num(np.array([np.median(angles[sight.image == k]) for k in np.flatnonzero(images)]), nan=180.0)
    what = (
        f"{_whom(block, images)}: the rays miss their points by {np.median(worst):.3g} deg (median) at the approximate"
        " orientation, and no resection agrees with them"
    )
    cure = "correct images.csv, or the names and coordinates of the points on these images"
    order = np.flatnonzero(images)[np.argsort(-worst)]
    subjects = tuple(Subject("images", (block.structure.image_names[k],)) for k in order)
    return Finding(Kind.START, what, cure, subjects, float(np.median(worst)), "deg")


def _one_place(block: Block) -> list[Finding]:
    """The finding that all stations are equal."""
    centres = np.asarray(block.exterior.projection_centre)
    if len(centres) < 2 or np.abs(centres - centres[0]).max() > ONE_PLACE * max(np.abs(centres).max(), 1e-300):
        return []
    place = ", ".join(f"{x:g}" for x in centres[0])
    what = f"all {len(centres)} images have the same approximate projection centre ({place})"
    return [
        Finding(Kind.START, what, "give each image its own X0, Y0, Z0", _subjects(block, np.ones(len(centres), bool)))
    ]


def _behind(block: Block, sight: Sight, judged: Bool[np.ndarray, " ray"]) -> list[Finding]:
    """Findings about rays with their point behind the camera, or without a direction."""
    s = block.structure
    angle = off(sight, sight.believed)
    findings = []
    centred = np.flatnonzero(np.isnan(angle))
    if len(centred):
        pairs = [(s.image_names[sight.image[k]], s.point_names[sight.point[k]]) for k in centred]
        listing = named([f"point {point} in that of image {image}" for image, point in pairs])
        what = f"{counted(len(pairs), 'approximate point')} coincide with a projection centre: {listing}"
        subjects = tuple(Subject("points", (point,)) for point in dict.fromkeys(point for _, point in pairs))
        findings.append(Finding(Kind.START, what, "correct the coordinates of the point or of the image", subjects))
    behind = judged & (angle > HALF)
    count = np.bincount(sight.image[behind], minlength=len(s.image_names))
    rays = np.bincount(sight.image, minlength=len(s.image_names))
    images = count > MOST * rays
    if images.any() or behind.sum() > FEW_BEHIND * len(behind):
        images |= (count > 0) & ~images.any()
        share = f"{behind.sum()} of {len(behind)} rays"
        what = f"{share} have their approximate point behind the camera: {_whom(block, images)}"
        cure = "check the signs of Z0 and of the angles, and whether y of the image coordinates points up or down"
        findings.append(Finding(Kind.START, what, cure, _subjects(block, images), float(behind.sum()), "rays"))
    return findings


def two_roles(block: Block) -> list[Finding]:
    """The finding about check points that are also control points."""
    s = block.structure
    control = {
        int(p)
        for group in block.groups
        if group.structure.kind.name == "control"
        for p in group.structure.indices[:, 0]
    }
    control |= set(np.flatnonzero(~s.point_free.any(1)).tolist())
    names = [s.point_names[p] for p in s.check_point.tolist() if p in control]
    if not names:
        return []
    what = f"{counted(len(names), 'point')} both control and check: {named(names)}"
    subjects = tuple(Subject("control", (name,)) for name in names)
    cure = "a check point must not be used in the adjustment: give each point one role"
    return [Finding(Kind.CONTROL_SYSTEM, what, cure, subjects, grade=Severity.CHECK)]
