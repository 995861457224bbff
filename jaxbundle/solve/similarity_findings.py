"""Findings about undetermined similarity transformations: of the whole block (datum defect), and of its parts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observed_places import frame_of, observed_places
from jaxbundle.block.parts import Part
from jaxbundle.block.similarity_defect import SimilarityDefect, displacements, similarity_defect
from jaxbundle.block.wording import NAMED, counted, named

MOVES = 1e-6  # share of the maximum coefficient: below this a part is at rest
AT_REST = 1e-6  # share of the radius: distance of a position on the axis of a rotation


class Gauge(NamedTuple):
    """Undetermined transformations as columns: (t, r, m) of the whole block, and of each part.

    t is in units of `radius`, and all refer to `origin`.
    """

    whole: Float[np.ndarray, "7 direction"]
    by_part: tuple[Float[np.ndarray, "7 direction"], ...]
    parts: tuple[Part, ...]
    origin: Float[np.ndarray, "3"]
    radius: float


def gauge_findings(block: Block, gauge: Gauge) -> list[Finding]:
    """One finding for the datum of the block, one for its parts; none where everything is determined."""
    if len(gauge.by_part) > 1:
        return [_parts(block.structure, gauge)]
    if not gauge.whole.shape[1]:
        return []
    defect = similarity_defect(orthonormal(gauge.whole))
    frame = frame_of(block)
    what, places = defect.words, observed_places(block, frame)
    subjects: tuple[Subject, ...] = ()
    if defect.count == len(defect.axes) == 1:
        at = np.array([place for *_, place in places]).reshape(-1, 3) + frame.centre - gauge.origin
        turn = gauge.whole / np.linalg.norm(gauge.whole[3:6])
        size = np.linalg.norm(displacements(turn, at, gauge.radius)[0], axis=1)
        resting = [places[k][:2] for k in np.flatnonzero(size <= AT_REST * gauge.radius)]
        if len(resting) > 1:
            what = f"the rotation about the line through {named([name for _, name in resting])}"
        subjects = tuple(Subject("control" if entity == "point" else "stations", (name,)) for entity, name in resting)
    return [
        Finding(
            Kind.UNDETERMINED,
            f"control and observed stations do not determine {what}",
            "add control, or observed stations, away from the existing ones",
            subjects,
        )
    ]


def _parts(structure: Structure, gauge: Gauge) -> Finding:
    """The finding about parts: their images, and the undetermined transformations relative to the others."""
    largest = max(float(np.abs(c).max(initial=0.0)) for c in gauge.by_part)
    described, open_parts, subjects = [], [], []
    for number, (part, coefficients) in enumerate(zip(gauge.parts, gauge.by_part, strict=True), 1):
        names = [structure.image_names[i] for i in part.images]
        described.append(f"{_images(names)} ({counted(len(part.points), 'point')})")
        subjects += [Subject("images", (name,), f"part {number}") for name in names]
        if np.abs(coefficients).max(initial=0.0) > MOVES * largest:
            defect: SimilarityDefect = similarity_defect(orthonormal(coefficients))
            open_parts.append(f"{defect.words} of the part of {_images(names)}")
    common = np.unique(np.concatenate([part.common for part in gauge.parts]))
    shared = [structure.point_names[p] for p in common]
    link = (
        f"connected by {counted(len(shared), 'point')} only ({named(shared)})" if shared else "without a common point"
    )
    what = (
        f"the block consists of {len(gauge.parts)} parts {link}: {'; '.join(described[:NAMED])}"
        f"{'; ...' if len(described) > NAMED else ''}. Relative to the rest the observations do not determine"
        f" {'; '.join(open_parts[:NAMED])}"
    )
    cure = "measure three or more well spread points common to the parts, or give each part its own control"
    return Finding(Kind.PARTS, what, cure, tuple(subjects))


def _images(names: list[str]) -> str:
    return f"{'image' if len(names) == 1 else f'{len(names)} images'} {named(names)}"


def orthonormal(columns: Float[np.ndarray, "7 direction"]) -> Float[np.ndarray, "7 k"]:
    """Orthonormal columns that span the same space as the given ones."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > 1e-6 * size.max(initial=0.0)]
