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
from jaxbundle.orientation.checked_start import checked_start
from jaxbundle.orientation.from_nothing import with_images_replaced
from jaxbundle.orientation.sight import sight_of
from jaxbundle.orientation.start_findings import found_orientations


def plausibility(block: Block) -> tuple[Finding, ...]:
    """Findings about implausible numbers of a concrete block, by severity, causes first.

    Example:
        >>> jb.blocks.plausibility(block)
        ()
    """
    return prepared(block)[1] if block.concrete else ()


def prepared(block: Block) -> tuple[Block, tuple[Finding, ...]]:
    """The block with checked approximate values, and findings about implausible numbers and replaced values.

    Orientations that are not given are computed from the rays.

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
        control = [] if checked.suspects.any() else control_findings(checked.block, checked.sight)
        told = {subject.names[0] for finding in control for subject in finding.subjects}
        findings += [*checked.findings, *control, *start_findings(block, sight, checked, told)]
    return checked.block, in_order(findings)
