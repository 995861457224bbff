"""Choosing the conventions of a file by its rays: alternatives are tried, the choice is reported or refused."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.formats.foreign_block import ForeignBlock
from jaxbundle.io.formats.intersected import with_intersections
from jaxbundle.io.formats.misfit import Misfit, Misfits, misfits

REFUSED = 0.05  # share of the image width: a wrong axis, matrix or unit exceeds it, approximate orientations do not
CLEAR = 0.98  # an alternative is preferred to the described conventions if its misfit is below this share of theirs


class _Tried(NamedTuple):
    words: str
    foreign: ForeignBlock
    fit: Misfits

    @property
    def first(self) -> Misfit:
        """The misfit that decides on a refusal: of the tie rays, or of control where there are none."""
        return self.fit.tie if self.fit.tie.rays else self.fit.control

    @property
    def judged(self) -> float:
        """Misfit of tie rays and control; control in another system counts at most as the limit of refusal."""
        control = self.fit.control.share if self.fit.control.rays else 0.0
        return float(np.hypot(self.first.share, min(control, REFUSED)))


def decided(foreign: ForeignBlock) -> ForeignBlock:
    """The best interpretation, with intersected points and findings about its misfit and the choice.

    Raises: BlockError where no interpretation fits, with the misfit of each.
    """
    tried = [_tried(foreign.reading or "as described", foreign)]
    tried += [_tried(other.words, other.changed(foreign)) for other in foreign.alternatives]
    first = tried[0]
    if not first.first.rays:
        return dataclasses.replace(first.foreign, alternatives=())
    best = min(tried, key=lambda one: one.judged if one.judged == one.judged else np.inf)
    if not best.judged < CLEAR * first.judged:
        best = first
    if not best.first.share <= REFUSED:
        raise BlockError([_refusal(foreign, tried)])
    unit = unit_of(best.foreign)
    findings = [_fit(best)]
    if len(tried) > 1:
        others = "; ".join(f"{one.words}: {_shown(one.first, unit)}" for one in tried if one is not best)
        findings.append(Finding(Kind.INFORMATION, f"the file was read {best.words}, which fits best ({others})"))
    return dataclasses.replace(best.foreign, alternatives=(), findings=(*findings, *best.foreign.findings))


def _tried(words: str, foreign: ForeignBlock) -> _Tried:
    foreign = with_intersections(foreign)
    return _Tried(words, foreign, misfits(foreign))


def unit_of(foreign: ForeignBlock) -> str:
    """Unit of the rays in words; "px or mm" where cameras differ."""
    return " or ".join(sorted({camera.image_unit for camera in foreign.cameras}, reverse=True))


def _shown(fit: Misfit, unit: str) -> str:
    behind = f", {fit.behind} of {fit.rays} points behind cameras" if fit.behind else ""
    return f"{fit.rms:.4g} {unit} rms{behind}"


def _fit(one: _Tried) -> Finding:
    foreign, (tie, control) = one.foreign, one.fit
    unit, parts = unit_of(foreign), []
    if tie.rays:
        parts.append(f"{tie.rays} tie rays: {_shown(tie, unit)}, largest {tie.largest:.4g} {unit}")
    if control.rays:
        parts.append(
            f"{control.rays} rays of control points: {_shown(control, unit)}, largest {control.largest:.4g} {unit}"
        )
    what = f"{foreign.format}, misfit at the values of the file: {'; '.join(parts)}"
    grade = Severity.CHECK if one.first.behind > 0.01 * one.first.rays else Severity.NOTE
    return Finding(Kind.INFORMATION, what, "", (), one.first.rms, unit, grade)


def _refusal(foreign: ForeignBlock, tried: list[_Tried]) -> Problem:
    unit = unit_of(foreign)
    shares = "; ".join(f"{x.words}: {_shown(x.first, unit)}, {100 * x.first.share:.3g} % of the image" for x in tried)
    return Problem(
        f"{foreign.format} {foreign.name}: the rays do not fit the orientations of the file ({shares}; allowed are"
        f" {100 * REFUSED:g} %)",
        "check that all files belong to one project, the size of the images, and that images were not rotated or scaled"
        " after they were measured; or export the project in another format",
    )
