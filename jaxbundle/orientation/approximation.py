"""Result of a start without approximate values: values, method, and quality of each step."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Severity
from jaxbundle.block.wording import counted, figure, named
from jaxbundle.orientation.to_object import Basis


class Way(Enum):
    """The method of the orientation of the images."""

    GIVEN = "given orientations: points intersected"
    RESECTION = "images resected from their control points"
    GLOBAL = "pairs oriented, rotations averaged, positions computed together"


class Figure(NamedTuple):
    """A number for the quality of a step."""

    name: str
    value: float
    unit: str = ""

    @property
    def words(self) -> str:
        """The number with its name and unit."""
        whole = math.isfinite(self.value) and self.value == round(self.value)
        value = f"{self.value:.0f}" if whole else figure(self.value)
        return f"{self.name} {value}{f' {self.unit}' if self.unit else ''}"


class Step(NamedTuple):
    """A step of the start with its numbers."""

    name: str
    figures: tuple[Figure, ...]

    @property
    def words(self) -> str:
        """The step as one line of text."""
        return f"{self.name}: {', '.join(f.words for f in self.figures)}"

    def value(self, name: str) -> float:
        """The number with this name."""
        return next(figure.value for figure in self.figures if figure.name == name)


class OrientedPart(NamedTuple):
    """Images that were oriented together, and the method of their transformation to the object system."""

    images: tuple[str, ...]
    basis: Basis


@dataclass(frozen=True, eq=False)
class Approximation:
    """Approximate values of a block, and the method of their computation.

    Example:
        >>> start = jb.approximate(block)
        >>> start.way.name, start.block
        ('GIVEN', <Block quarry: 4 images, 8 points, 32 rays, 1 camera, 12 control>)
    """

    block: Block
    """The block with its approximate values; an orientation that could not be computed is NaN."""
    way: Way
    """The method of the orientation of the images."""
    steps: tuple[Step, ...]
    """The steps in their order."""
    parts: tuple[OrientedPart, ...]
    """Parts of images that were oriented together, the largest first."""
    loose: tuple[str, ...]
    """Images that could not be oriented."""
    suspect_rays: Bool[np.ndarray, " ray"]
    """Rays that do not agree with the others. They were not used for the start; the adjustment uses them again."""
    findings: tuple[Finding, ...]
    """Findings about the block."""

    @property
    def complete(self) -> bool:
        """Whether all images have an orientation in one common system."""
        return not self.loose and len(self.parts) <= 1

    def summary(self) -> str:
        """The method, its steps and the findings, one line each."""
        oriented = sum(len(part.images) for part in self.parts)
        lines = [f"Start: {self.way.value}", f"  {oriented} of {counted(oriented + len(self.loose), 'image')} oriented"]
        lines += [f"  {step.words}" for step in self.steps]
        for k, part in enumerate(self.parts):
            who = (
                "" if len(self.parts) == 1 else f" {k + 1}: {counted(len(part.images), 'image')} ({named(part.images)})"
            )
            lines.append(f"  part{who} by {part.basis.value}")
        lines += [f"  {f.severity.label}: {f.words}" for f in self.findings if f.severity is not Severity.NOTE]
        return "\n".join(lines)
