"""Lists, numbers and units in the sentences that a user reads."""

import math
from collections.abc import Sequence

NAMED = 6  # names in one sentence; findings have all of them as subjects
RADIANS = {"deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0}  # angle units of the user
IMAGE = "image:"  # before the name of an image among the ends of an observation: its projection centre


def named(names: Sequence[str], most: int = NAMED) -> str:
    """Names in one sentence: the first few, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(number: int, noun: str) -> str:
    """A number and its noun: "1 image", "2 images"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def are(number: int) -> str:
    """The verb of so many."""
    return "is" if number == 1 else "are"


def figure(value: float, digits: int = 3) -> str:
    """A number with so many digits."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "not known"
