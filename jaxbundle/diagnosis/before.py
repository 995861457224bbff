"""Checking a block before its adjustment: plausibility of its numbers, likely cause and cure.

A cause is reported without its consequences: where the rays do not fit their format, or the principal distance is
absurd, orientations and control are not checked with them.
"""

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Severity, in_order
from jaxbundle.block.magnitudes import repeated_rows
from jaxbundle.block.unknowns import without_orientation
from jaxbundle.diagnosis.approximations import mirrored_finding, start_findings, two_roles
from jaxbundle.diagnosis.image_format import format_findings
from jaxbundle.diagnosis.interior import interior_findings
from jaxbundle.diagnosis.systems import control_findings
from jaxbundle.orientation.checked_start import FAR_SMALLER, ROUGH_FIT, CheckedStart, checked_start
from jaxbundle.orientation.from_nothing import with_images_replaced
from jaxbundle.orientation.replaced import replaced_images
from jaxbundle.orientation.sight import medians, relative_off, sight_of
from jaxbundle.orientation.start_findings import found_orientations


def plausibility(block: Block) -> tuple[Finding, ...]:
    """Findings about implausible numbers of a concrete block, by severity, causes first.

    Example:
        >>> jb.blocks.plausibility(block)
        ()
    """
    return prepared(block)[1]


def prepared(block: Block) -> tuple[Block, tuple[Finding, ...]]:
    """The block with checked approximate values, and findings about implausible numbers and replaced values.

    Orientations that are not given are computed from the rays, and so are absurd ones that no resection replaces.

    Approximate values are replaced only where the numbers used for the check are plausible.

    Example:
        >>> checked, found = jb.blocks.prepared(block)
        >>> found
        ()
    """
    if not block.concrete or not len(block.structure.ray_image) or not block.structure.model.photographs:
        return block, ()
    with np.errstate(all="ignore"):
        findings = [*format_findings(block), *interior_findings(block), *two_roles(block), *repeated_rows(block)]
        if any(finding.severity is Severity.FAILED for finding in findings):
            return block, in_order(findings)
        if without_orientation(block).any():
            found = with_images_replaced(block, np.zeros(len(block.structure.image_names), bool))
            block = found.block
            findings += [*found.findings, *found_orientations(found)]
            if found.loose:
                return block, in_order(findings)
        sight = sight_of(block)
        mirror = mirrored_finding(block, sight)
        if mirror is not None:
            return block, in_order([*findings, mirror])
        checked = checked_start(block, sight)
        if checked.suspects.any():
            block, checked, more = _oriented_anew(block, checked)
            findings += more
        control = [] if checked.suspects.any() else control_findings(checked.block, checked.sight)
        told = {subject.names[0] for finding in control for subject in finding.subjects}
        findings += [*checked.findings, *control, *start_findings(block, sight, checked, told)]
    return checked.block, in_order(findings)


def _oriented_anew(block: Block, checked: CheckedStart) -> tuple[Block, CheckedStart, list[Finding]]:
    """Absurd images oriented together from their rays, if then their rays meet; and that this was done."""
    wrong = checked.suspects & block.structure.exterior_free.all(1)
    if not wrong.any():
        return block, checked, []
    found = with_images_replaced(checked.block, wrong)
    if not found.complete:
        return block, checked, []
    sight = sight_of(found.block)
    left = medians(relative_off(sight, sight.believed), sight.image, len(wrong))
    before = medians(relative_off(checked.sight, checked.sight.believed), sight.image, len(wrong))
    if not (left[wrong] <= np.minimum(ROUGH_FIT, FAR_SMALLER * before[wrong])).all():
        return block, checked, []
    again = checked_start(found.block, sight)
    if again.suspects.any():
        return block, checked, []
    told = [*replaced_images(block, wrong, sight, "replaced by one found from the rays of all images"), *found.findings]
    return found.block, again._replace(findings=(*checked.findings, *again.findings)), told
