"""Findings of a start without approximate values about the block."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject, in_order
from jaxbundle.block.wording import are, counted, named
from jaxbundle.orientation.approximation import Approximation, OrientedPart
from jaxbundle.orientation.to_object import Basis


class Doubts(NamedTuple):
    """What of a block does not agree with the rest of it."""

    rays: Bool[np.ndarray, " ray"]
    control: Bool[np.ndarray, " point"]
    """Control points that are not near their places."""
    behind: Bool[np.ndarray, " point"]
    """Points whose rays meet behind their images."""
    scale: Bool[np.ndarray, " image"]
    """Images whose scale rests on fewer than three points."""


def start_findings(
    block: Block, parts: Sequence[OrientedPart], loose: Sequence[str], doubts: Doubts
) -> tuple[Finding, ...]:
    """All findings in the order of a report."""
    found = [
        *_loose(loose),
        *_parts(parts),
        *_assumption(parts),
        *_scale(block, doubts.scale),
        *_refused(block, doubts.control),
        *_suspects(block, doubts.rays),
        *_behind(block, doubts.behind),
    ]
    return in_order(found)


def _images(names: Sequence[str]) -> tuple[Subject, ...]:
    return tuple(Subject("images", (name,)) for name in names)


def _loose(names: Sequence[str]) -> list[Finding]:
    if not names:
        return []
    what = f"{counted(len(names), 'image')} could not be oriented: {named(names)}"
    cure = "measure more points, at least 8, that are also on other oriented images, or give approximate values"
    return [Finding(Kind.LOOSE, what, cure, _images(names), float(len(names)))]


def _parts(parts: Sequence[OrientedPart]) -> list[Finding]:
    if len(parts) < 2:
        return []
    listing = "; ".join(f"{counted(len(part.images), 'image')} ({named(part.images)})" for part in parts)
    what = f"the images form {len(parts)} separate parts, each with its own system: {listing}"
    cure = "measure points that connect the parts, or add control to each of them"
    return [Finding(Kind.PARTS, what, cure, _images(parts[1].images), float(len(parts)))]


def _assumption(parts: Sequence[OrientedPart]) -> list[Finding]:
    if not parts or parts[0].basis is not Basis.LINE:
        return []
    what = "control and stations lie on a line; the start assumes that the mean view is vertical"
    return [Finding(Kind.ASSUMED, what, "measure a control point off the line")]


def _scale(block: Block, doubted: Bool[np.ndarray, " image"]) -> list[Finding]:
    names = [block.structure.image_names[k] for k in np.flatnonzero(doubted)]
    if not names:
        return []
    what = (
        f"the distance of {counted(len(names), 'image')} from the others rests on fewer than 3 points that three images"
    )
    what += f" show: {named(names)}"
    cure = "measure more points that three images show, or their stations; compare the bases with the flight"
    return [Finding(Kind.WEAK, what, cure, _images(names), float(len(names)))]


def _refused(block: Block, refused: Bool[np.ndarray, " point"]) -> list[Finding]:
    names = [block.structure.point_names[k] for k in np.flatnonzero(refused)]
    if not names:
        return []
    what = f"{counted(len(names), 'control point')} {are(len(names))} not near {'its' if len(names) == 1 else 'their'}"
    what += f" position in the block: {named(names)}"
    cure = "check names and coordinates; the start does not use them, the adjustment does"
    return [Finding(Kind.SUSPECT, what, cure, _subjects(names))]


def _subjects(names: Sequence[str]) -> tuple[Subject, ...]:
    return tuple(Subject("control", (name,)) for name in names)


def _suspects(block: Block, suspects: Bool[np.ndarray, " ray"]) -> list[Finding]:
    s = block.structure
    rays = np.flatnonzero(suspects)
    if not len(rays):
        return []
    names = [(s.image_names[s.ray_image[k]], s.point_names[s.ray_point[k]]) for k in rays]
    listing = named([f"point {point} on image {image}" for image, point in names])
    what = f"{counted(len(names), 'ray')} {'does' if len(names) == 1 else 'do'} not agree with the others: {listing}"
    cure = "re-measure them, or adjust with robust weights; the start does not use them, the adjustment does"
    subjects = tuple(Subject("rays", pair) for pair in names)
    return [Finding(Kind.SUSPECT, what, cure, subjects, float(len(names)), "rays")]


def _behind(block: Block, behind: Bool[np.ndarray, " point"]) -> list[Finding]:
    names = [block.structure.point_names[k] for k in np.flatnonzero(behind)]
    if not names:
        return []
    it = "it" if len(names) == 1 else "them"
    what = f"the rays of {counted(len(names), 'point')} meet behind their images only: {named(names)}"
    cure = f"re-measure or remove {it}; the adjustment starts with {it} where the rays meet"
    return [Finding(Kind.SUSPECT, what, cure, tuple(Subject("points", (name,)) for name in names))]


def found_orientations(found: Approximation) -> tuple[Finding, ...]:
    """The finding about the method and the numbers of its steps."""
    steps = "; ".join(step.words for step in found.steps)
    number = sum(len(part.images) for part in found.parts)
    what = (
        f"the start was computed from the rays, with {counted(number, 'image')} oriented ({found.way.value}): {steps}"
    )
    return (Finding(Kind.APPROXIMATED, what, "", (), float(number)),)
