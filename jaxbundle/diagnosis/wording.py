"""Lists and numbers in the sentences of findings."""

import math
from collections.abc import Sequence

from jaxbundle.block.block import Structure
from jaxbundle.block.findings import Subject

NAMED = 5  # examples in one sentence


def named(names: Sequence[str], most: int = NAMED) -> str:
    """Names in one sentence: the first few, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """A number and its noun, in the plural unless it is 1."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def are(number: int) -> str:
    """The verb of so many."""
    return "is" if number == 1 else "are"


def figure(value: float, digits: int = 3) -> str:
    """A number with so many digits, never with more than nine places in front of the point."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "not known"


def ray_subject(structure: Structure, ray: int) -> Subject:
    """Image and point of a ray."""
    image, point = structure.ray_image[ray], structure.ray_point[ray]
    return Subject("rays", (structure.image_names[image], structure.point_names[point]))


def ray_name(structure: Structure, ray: int) -> str:
    """A ray as it stands in a sentence."""
    subject = ray_subject(structure, ray)
    return f"point {subject.names[1]} on image {subject.names[0]}"
