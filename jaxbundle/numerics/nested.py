"""The type of arguments that a function converts to an array itself."""

from collections.abc import Sequence
from typing import Any

Nested = Sequence[Any]  # numbers, or sequences of equal length: in place of an array
