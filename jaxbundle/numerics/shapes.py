"""Padded sizes of arrays: arrays with equal shapes share one compiled program."""

from typing import Any

import numpy as np
from jaxtyping import Shaped

MIN_ENTITIES, MIN_MEMBERS, MIN_POINTS = 16, 32, 64  # sizes of the smallest padded arrays


def grid_size(count: int, least: int = MIN_ENTITIES, ratio: float = 1.125) -> int:
    """The next size on a geometric grid: few sizes mean few compilations."""
    size = least
    while size < count:
        size = int(size * ratio) + 1
    return size


def padded(values: Shaped[Any, "*axis entity"], least: int = MIN_ENTITIES) -> Shaped[np.ndarray, "*axis padded"]:
    """An array with its long axis padded by copies of the last column; without any column it is unchanged."""
    values = np.asarray(values)
    count = values.shape[-1]
    return values[..., np.minimum(np.arange(grid_size(count, least)), count - 1)] if count else values
