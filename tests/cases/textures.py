"""Images with a known shift or a known warp between them."""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage


def box(image: np.ndarray, size: int, right: int) -> np.ndarray:
    """Means of size x size pixels from a column on: shifted by right / size of its pixels exactly."""
    image = image[:, right:]
    rows, columns = image.shape[0] // size, image.shape[1] // size
    return image[: rows * size, : columns * size].reshape(rows, size, columns, size).mean((1, 3))


def grey_image(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("L"), float)


def interest_points(image: np.ndarray, half: int, margin: int, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the strongest points of the Foerstner operator, w = det N / tr N, where q > 0.6."""
    gy, gx = np.gradient(ndimage.gaussian_filter(image, 0.7))
    xx, xy, yy = (ndimage.uniform_filter(g, 2 * half + 1) for g in (gx * gx, gx * gy, gy * gy))
    determinant, trace = xx * yy - xy * xy, xx + yy
    w = np.where(4 * determinant > 0.6 * trace**2, determinant / np.maximum(trace, 1e-9), 0)
    w[ndimage.maximum_filter(w, 2 * half + 1) > w] = 0
    w[:margin] = w[-margin:] = w[:, :margin] = w[:, -margin:] = 0
    order = np.argsort(-w, axis=None)[:number]
    rows, columns = np.unravel_index(order[w.ravel()[order] > 0], w.shape)
    return rows, columns


def cut(image: np.ndarray, rows: np.ndarray, columns: np.ndarray, half: int) -> np.ndarray:
    size = 2 * half + 1
    return np.lib.stride_tricks.sliding_window_view(image, (size, size))[rows - half, columns - half]


class Waves:
    """A band-limited texture that is known between its pixels."""

    def __init__(self, seed: int, number: int = 60, shortest: float = 5.0):
        rng = np.random.default_rng(seed)
        length = 2 * np.pi / rng.uniform(shortest, 40, number)
        angle = rng.uniform(0, 2 * np.pi, number)
        self.kx, self.ky = length * np.cos(angle), length * np.sin(angle)
        self.phase, self.size = rng.uniform(0, 2 * np.pi, number), rng.uniform(2, 10, number)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        waves = np.cos(x[..., None] * self.kx + y[..., None] * self.ky + self.phase)
        return 128 + waves @ self.size


def pixel_centres(size: int, middle: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the pixels of a window from its middle, and where that lies."""
    centre = np.arange(size) - (size - 1) / 2
    x, y = np.meshgrid(centre, centre)
    return x + middle[0], y + middle[1]
