"""Detecting adjusted boresights that are too large for a misalignment of two instruments.

    cos(angle) = (tr R_b - 1) / 2,    R_b: from photograph to inertial unit (block/navigation.py)

A mounting is misaligned by a few degrees. A larger rotation is another definition of the axes: an angle with another
zero direction, or another system of angles than that of the photographs.
"""

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.wording import named
from jaxbundle.solve.adjustment import Adjustment

MISALIGNED = 10.0  # deg: mountings are aligned to a few degrees (Skaloud 1999), and different axes differ by more
RIGHT_ANGLE = 90.0  # deg: axes are exchanged or rotated by multiples of this


def boresight_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """One finding for each unknown boresight with a rotation larger than any misalignment."""
    found = []
    for parameters in _unknown_boresights(adjustment.block):
        values = np.asarray(adjustment.block.parameters)[list(parameters)]
        angle = _angle(adjustment.block, values)
        if angle > MISALIGNED:
            found.append(_finding(adjustment.block, parameters, values, angle))
    return tuple(found)


def _unknown_boresights(block: Block) -> list[tuple[int, ...]]:
    """Indices of the three parameters of each boresight with an unknown angle."""
    free = block.structure.parameter_free
    groups = [group.structure for group in block.groups if group.structure.kind.name == "attitudes"]
    every = dict.fromkeys(tuple(row[1:4].tolist()) for group in groups for row in group.indices)
    return [parameters for parameters in every if free[list(parameters)].any()]


def _angle(block: Block, values: np.ndarray) -> float:
    """Angle of the complete rotation, deg."""
    rotation = block.structure.rotation_system.rotation_from_angles(*values.tolist())
    trace = float(rotation[0]) + float(rotation[4]) + float(rotation[8])
    return float(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))))


def _finding(block: Block, parameters: tuple[int, ...], values: np.ndarray, angle: float) -> Finding:
    names = [block.structure.parameters[k].name for k in parameters]
    degrees = np.degrees(values)
    listed = named([f"{name} {value:.4g} deg" for name, value in zip(names, degrees, strict=True)])
    what = f"a boresight rotates by {angle:.4g} deg, too much for a misalignment: {listed}"
    turned = [
        f"{name.partition(' ')[2].partition(' of ')[0]} by {RIGHT_ANGLE * round(value / RIGHT_ANGLE):g} deg"
        for name, value in zip(names, degrees, strict=True)
        if round(value / RIGHT_ANGLE) and abs(value - RIGHT_ANGLE * round(value / RIGHT_ANGLE)) < MISALIGNED
    ]
    likely = f"; the likely cause are errors of the observed attitudes in {named(turned)}" if turned else ""
    cure = f"check sign, axes and zero directions of the observed attitudes and of the photographs{likely}"
    subjects = tuple(Subject("parameters", (name,)) for name in names)
    return Finding(Kind.WEAK, what, cure, subjects, angle, "deg")
