"""Images that give their levels from memory, as a pyramid does from its file."""

from dataclasses import dataclass

import numpy as np

from jaxbundle.imagery.levels import halved


@dataclass(frozen=True)
class InMemory:
    levels: tuple[np.ndarray, ...]

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        return tuple((len(level), level.shape[1]) for level in self.levels)

    def grey(self, level: int) -> np.ndarray:
        return self.levels[level]


def in_memory(image: np.ndarray, number: int = 1) -> InMemory:
    levels = [np.asarray(image, np.float32)]
    for _ in range(number - 1):
        levels.append(halved(levels[-1]))
    return InMemory(tuple(levels))
