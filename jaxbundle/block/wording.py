"""Formatting lists, numbers and units in sentences for users."""

import math
from collections.abc import Sequence

NAMED = 6  # maximum number of names in one sentence; findings have all of them as subjects
RADIANS = {"deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0}  # angle units of users in radians
IMAGE = "image:"  # prefix of an image as the end of an observation, which means its projection centre


def named(names: Sequence[str], most: int = NAMED) -> str:
    """Names in one sentence: the first few, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """A number and its noun: "1 image", "2 images"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def are(number: int) -> str:
    """The verb "is" or "are" for a number."""
    return "is" if number == 1 else "are"


def figure(value: float, digits: int = 3) -> str:
    """A number with a number of digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "unknown"
