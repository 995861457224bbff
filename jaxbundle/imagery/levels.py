"""The levels of an image pyramid: computation of a level, its size, and coordinates between levels.

    g_{l+1}(i, j) = mean of g_l(2i, 2j), g_l(2i+1, 2j), g_l(2i, 2j+1), g_l(2i+1, 2j+1)
    size_{l+1} = ceil(size_l / 2);  u_l = 2 u_{l+1}

Integers are rounded half up, from the rounded level below, as GDAL and Pillow do. For an odd size the last row or
column is repeated, so that the scale between levels is exactly 2 and one formula is valid for coordinates. (GDAL cuts
an odd size into equal parts instead: its levels have another scale.)

Image coordinates have their origin in the corner of the first pixel, whose centre is (0.5, 0.5), on each level.
"""

import math
from typing import TypeVar

import numpy as np
from jaxtyping import Array, Num

T = TypeVar("T", float, np.ndarray, Array)
SMALLEST = 256  # px: the longer side of the last level, which fits a tile
WIDER = {"uint8": np.uint16, "uint16": np.uint32}  # types that can store the sum of four values
GREY = 0.299, 0.587, 0.114  # luminance of red, green and blue (ITU-R BT.601)


def halved(image: Num[np.ndarray, "row column *channel"]) -> Num[np.ndarray, "row2 column2 *channel"]:
    """The next level of an image: means of 2 x 2 pixels.

    Args:
        image: 8 or 16 bit or floating point, grey or with channels.

    Returns: half as many rows and columns, rounded up, of the same type.

    Example:
        >>> jb.imagery.halved(np.array([[10, 12, 9], [14, 12, 9]], np.uint8))
        array([[12,  9]], dtype=uint8)
    """
    rows, columns = image.shape[:2]
    if rows % 2 or columns % 2:
        image = np.pad(image, [(0, rows % 2), (0, columns % 2)] + [(0, 0)] * (image.ndim - 2), mode="edge")
    wide = image.astype(WIDER.get(image.dtype.name, image.dtype), copy=False)
    upper = wide[0::2, 0::2] + wide[0::2, 1::2]
    total = upper + (wide[1::2, 0::2] + wide[1::2, 1::2])
    if image.dtype.kind == "f":
        return total / image.dtype.type(4)
    return ((total + 2) >> 2).astype(image.dtype)


def level_sizes(rows: int, columns: int, smallest: int = SMALLEST) -> tuple[tuple[int, int], ...]:
    """Rows and columns of all levels, until the longer side is at most `smallest`.

    Example:
        >>> jb.imagery.level_sizes(513, 641)
        ((513, 641), (257, 321), (129, 161))
    """
    sizes = [(rows, columns)]
    while max(sizes[-1]) > smallest:
        sizes.append((math.ceil(sizes[-1][0] / 2), math.ceil(sizes[-1][1] / 2)))
    return tuple(sizes)


def between_levels(coordinates: T, from_level: int, to_level: int) -> T:
    """Converts image coordinates from one level to another; also lengths and standard deviations in px.

    Example:
        >>> jb.imagery.between_levels(10.5, 0, 1)
        5.25
    """
    return coordinates * 2.0 ** (from_level - to_level)


def grey(image: Num[np.ndarray, "row column *channel"]) -> np.ndarray:
    """Grey values in double precision: the luminance of a colour image."""
    values = np.asarray(image, float)
    return values if values.ndim == 2 else values[..., :3] @ np.array(GREY) if values.shape[2] >= 3 else values[..., 0]
