"""The reading of a file that its rays decide for: other readings are tried, the choice is told, nonsense is refused."""

import dataclasses

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.formats.foreign_block import ForeignBlock
from jaxbundle.io.formats.misfit import Misfit, misfit

REFUSED = 0.05  # of the image width: a wrong axis, matrix or unit misses by more, approximate orientations by less
CLEAR = 0.98  # a reading is preferred to that of the file's description if its misfit is below this share of it


def decided(foreign: ForeignBlock) -> ForeignBlock:
    """The best reading, with findings that tell its misfit and, where there was a choice, the choice.

    Raises: BlockError where no reading fits, with the misfit of each.
    """
    tried = [(foreign.reading or "as described", foreign, misfit(foreign))]
    for alternative in foreign.alternatives:
        changed = alternative.changed(foreign)
        tried.append((alternative.words, changed, misfit(changed)))
    first = tried[0]
    if not first[2].rays:
        return dataclasses.replace(foreign, alternatives=())
    best = min(tried, key=lambda one: one[2].share)
    if not best[2].share < CLEAR * first[2].share:
        best = first
    if not best[2].share <= REFUSED:
        raise BlockError([_refusal(foreign, tried)])
    words, chosen, of_chosen = best
    unit = unit_of(chosen)
    findings = [_fit(chosen, of_chosen)]
    if len(tried) > 1:
        others = "; ".join(f"{name}: {_shown(other, unit)}" for name, _, other in tried if name != words)
        findings.append(Finding(Kind.INFORMATION, f"the file was read {words}, which fits best ({others})"))
    return dataclasses.replace(chosen, alternatives=(), findings=(*findings, *chosen.findings))


def unit_of(foreign: ForeignBlock) -> str:
    """Unit of the rays; "px or mm" where cameras differ."""
    return " or ".join(sorted({camera.image_unit for camera in foreign.cameras}, reverse=True))


def _shown(fit: Misfit, unit: str) -> str:
    behind = f", {fit.behind} of {fit.rays} points behind cameras" if fit.behind else ""
    return f"{fit.rms:.4g} {unit} rms{behind}"


def _fit(foreign: ForeignBlock, fit: Misfit) -> Finding:
    unit = unit_of(foreign)
    what = f"{foreign.format}: {fit.rays} rays at the file's own values: {_shown(fit, unit)}, largest {fit.largest:.4g} {unit}"
    grade = Severity.CHECK if fit.behind > 0.01 * fit.rays else Severity.NOTE
    return Finding(Kind.INFORMATION, what, "", (), fit.rms, unit, grade)


def _refusal(foreign: ForeignBlock, tried: list[tuple[str, ForeignBlock, Misfit]]) -> Problem:
    unit = unit_of(foreign)
    shares = "; ".join(f"{words}: {_shown(fit, unit)}, {100 * fit.share:.3g} % of the image" for words, _, fit in tried)
    return Problem(
        f"{foreign.format} {foreign.name}: the rays do not fit the orientations of the file ({shares}; allowed are"
        f" {100 * REFUSED:g} %)",
        "check that all files belong to one project, the size of the images, and that images were not turned or scaled"
        " after they were measured; or export it in another form",
    )
