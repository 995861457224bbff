"""Square windows around image points, cut from the levels of image pyramids."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

REMEMBERED = 24  # number of cached levels of images: neighbours of one strip and of the next


@runtime_checkable
class GreyLevels(Protocol):
    """Protocol of an image with grey values of its levels, such as `Pyramid`."""

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """Rows and columns of each level."""
        ...

    def grey(self, level: int) -> np.ndarray:
        """Grey values of a level, (row, column)."""
        ...


class Windows(NamedTuple):
    """Windows and their positions."""

    grey: Float[np.ndarray, "window row column"]
    corner: Float[np.ndarray, "window 2"]
    """Coordinates x, y of the corner of each window in the image, px of the level."""
    inside: Bool[np.ndarray, " window"]
    """Mask of windows that are completely inside their image; the others are 0."""


class GreyImages:
    """Images by their indices, with a cache of recently used levels."""

    def __init__(self, images: Mapping[int, GreyLevels]):
        self._images = images
        self._levels: dict[tuple[int, int], np.ndarray] = {}

    def __contains__(self, image: int) -> bool:
        return image in self._images

    def levels(self, image: int) -> int:
        """Number of levels of an image."""
        return len(self._images[image].sizes)

    def level(self, image: int, level: int) -> np.ndarray:
        """Grey values of a level in single precision, which is exact for 16 bit."""
        key = image, level
        if key in self._levels:
            self._levels[key] = self._levels.pop(key)
        else:
            if len(self._levels) >= REMEMBERED:
                del self._levels[next(iter(self._levels))]
            self._levels[key] = np.asarray(self._images[image].grey(level), np.float32)
        return self._levels[key]

    def cut(
        self,
        image: Int[np.ndarray, " window"],
        level: Int[np.ndarray, " window"],
        centre: Float[np.ndarray, "window 2"],
        half: int,
    ) -> Windows:
        """Cuts windows of 2 half + 1 pixels whose central pixels contain the given points (coordinates of level 0)."""
        size = 2 * half + 1
        xy = centre * 0.5 ** level[:, None]  # like `between_levels`, with a level for each window
        corner = np.floor(np.where(np.isfinite(xy), xy, -1e9)) - half
        grey = np.zeros((len(image), size, size), np.float32)
        inside = np.zeros(len(image), bool)
        for i, k in sorted({(int(i), int(k)) for i, k in zip(image, level, strict=True)}):
            own = np.flatnonzero((image == i) & (level == k))
            if i not in self._images or not 0 <= k < self.levels(i):
                continue
            whole = self.level(i, k)
            rows, columns = whole.shape
            x, y = corner[own].T
            fits = (x >= 0) & (y >= 0) & (x + size <= columns) & (y + size <= rows)
            inside[own] = fits
            if fits.any():
                views = np.lib.stride_tricks.sliding_window_view(whole, (size, size))
                grey[own[fits]] = views[y[fits].astype(int), x[fits].astype(int)]
        return Windows(grey, corner, inside)
