"""Aerial blocks of several sizes as BAL files: strips of images with 80/60 or 60/30 % overlap over a flat ground."""

from pathlib import Path

import numpy as np

from jaxbundle.geometry.rotation import from_rotation_vector

FOCAL, HALF, HEIGHT = 1000.0, 1000.0, 1000.0  # px, px, m: ground sample of 1 m
SIZES: dict[str, tuple[int, int, int, float, float]] = {
    "48": (4, 12, 150, 0.6, 0.3),
    "110": (5, 22, 200, 0.8, 0.6),
    "320": (8, 40, 200, 0.8, 0.6),
    "1200": (20, 60, 200, 0.8, 0.6),
}


def write_block(path: Path, strips: int, images: int, points_per_image: int, forward: float, side: float) -> None:
    """Writes a block with noise of 0.5 px and approximate values some 5 m and 0.3 deg off."""
    rng = np.random.default_rng(0)
    base, width = (2 * HALF / FOCAL * HEIGHT * (1 - overlap) for overlap in (forward, side))
    row, column = np.divmod(np.arange(strips * images), images)
    centres = np.stack([column * base, row * width, np.full(len(row), HEIGHT)], 1) + rng.normal(0, 10, (len(row), 3))
    turns = rng.normal(0, 0.02, centres.shape)
    high = np.array([(images - 1) * base, (strips - 1) * width]) + 0.8 * HEIGHT
    count = points_per_image * len(centres)
    points = np.c_[rng.uniform(-0.8 * HEIGHT, high, (count, 2)), rng.uniform(-50, 50, count)]
    rays = []
    for image, (centre, matrix) in enumerate(zip(centres, _matrices(turns), strict=True)):
        p = (points - centre) @ matrix.T
        xy = -FOCAL * p[:, :2] / p[:, 2:]
        seen = np.flatnonzero((np.abs(xy) < HALF).all(1))
        measured = xy[seen] + rng.normal(0, 0.5, (len(seen), 2))
        rays.append(np.c_[np.full(len(seen), image), seen, measured])
    ray = np.concatenate(rays)
    track = np.bincount(ray[:, 1].astype(int), minlength=count)
    ray = ray[track[ray[:, 1].astype(int)] >= 2]
    number = np.cumsum(track >= 2) - 1
    ray[:, 1] = number[ray[:, 1].astype(int)]
    ray = ray[np.argsort(ray[:, 1], kind="stable")]
    points = points[track >= 2] + rng.normal(0, 5, (int((track >= 2).sum()), 3))
    turns = turns + rng.normal(0, 0.005, turns.shape)
    centres = centres + rng.normal(0, 5, centres.shape)
    shifts = -np.einsum("iab,ib->ia", _matrices(turns), centres)
    interior = np.broadcast_to([FOCAL, 0.0, 0.0], turns.shape)
    with path.open("w") as file:
        file.write(f"{len(centres)} {len(points)} {len(ray)}\n")
        np.savetxt(file, ray, "%d %d %.6e %.6e")
        np.savetxt(file, np.c_[turns, shifts, interior].ravel(), "%.16e")
        np.savetxt(file, points.ravel(), "%.16e")


def _matrices(vectors: np.ndarray) -> np.ndarray:
    return np.stack([np.asarray(element) for element in from_rotation_vector(*vectors.T)], 1).reshape(-1, 3, 3)
