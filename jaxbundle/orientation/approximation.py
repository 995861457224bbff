"""What a start from nothing gives: approximate values, how they were found, and how good each step was."""

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
    """How the images were oriented."""

    GIVEN = "orientations given: points intersected"
    RESECTION = "images resected from their control points"
    GLOBAL = "pairs oriented, rotations averaged, positions found together"


class Figure(NamedTuple):
    """A number that tells how good a step was."""

    name: str
    value: float
    unit: str = ""

    @property
    def words(self) -> str:
        """The number with its name."""
        whole = math.isfinite(self.value) and self.value == round(self.value)
        value = f"{self.value:.0f}" if whole else figure(self.value)
        return f"{self.name} {value}{f' {self.unit}' if self.unit else ''}"


class Step(NamedTuple):
    """A step of the start with its figures."""

    name: str
    figures: tuple[Figure, ...]

    @property
    def words(self) -> str:
        """One line."""
        return f"{self.name}: {', '.join(f.words for f in self.figures)}"

    def value(self, name: str) -> float:
        """A figure by its name."""
        return next(figure.value for figure in self.figures if figure.name == name)


class OrientedPart(NamedTuple):
    """Images that were oriented together, and how they came into the object system."""

    images: tuple[str, ...]
    basis: Basis


@dataclass(frozen=True, eq=False)
class Approximation:
    """Approximate values of a block, and how they were found."""

    block: Block
    """The block with its start; an orientation that could not be found is NaN."""
    way: Way
    """How the images were oriented."""
    steps: tuple[Step, ...]
    """In the order of the work."""
    parts: tuple[OrientedPart, ...]
    """Images that were oriented together, the largest part first."""
    loose: tuple[str, ...]
    """Images that could not be oriented."""
    suspect_rays: Bool[np.ndarray, " ray"]
    """Rays that do not agree with the others. They were left out of the start; the adjustment tries them again."""
    findings: tuple[Finding, ...]
    """What is wrong with the block or was done to it, in words and as objects."""

    @property
    def complete(self) -> bool:
        """Whether every image has an orientation and all of them one system."""
        return not self.loose and len(self.parts) <= 1

    def summary(self) -> str:
        """The way, its steps and what was found, one line each."""
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
