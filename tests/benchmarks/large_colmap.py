"""Reads a large COLMAP model: python tests/benchmarks/large_colmap.py [--rays 2700000]

A model of images in strips, each point seen by nine, is written to a temporary folder; printed are its size, the time
and the memory of reading the records and of making the block.
"""

import argparse
import resource
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxbundle.cli import runtime
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.colmap import read_colmap
from jaxbundle.io.formats.colmap_binary import IMAGE_POINT

SEEN, WIDTH, HEIGHT, F = 9, 4000, 3000, 3000.0
BASE, HEIGHT_ABOVE = 20.0, 100.0


def write_model(folder: Path, rays: int) -> None:
    """Images looking down on a line; every point lies below the middle of nine of them."""
    rng = np.random.default_rng(0)
    points = rays // SEEN
    images = max(points // 150, SEEN)
    first = rng.integers(0, images - SEEN + 1, points)
    x = (first + SEEN / 2) * BASE / SEEN + rng.uniform(-3, 3, points)
    place = np.c_[x, rng.uniform(-30, 30, points), rng.uniform(-5, 5, points)]
    image = (first[:, None] + np.arange(SEEN)).ravel()
    point = np.repeat(np.arange(points), SEEN)
    camera = np.c_[np.arange(images) * BASE / SEEN, np.zeros(images), np.full(images, HEIGHT_ABOVE)]
    p = place[point] - camera[image]
    xy = np.c_[WIDTH / 2 + F * p[:, 0] / -p[:, 2], HEIGHT / 2 - F * p[:, 1] / -p[:, 2]] + rng.normal(
        0, 0.5, (len(p), 2)
    )
    order = np.argsort(image, kind="stable")
    starts = np.searchsorted(image[order], np.arange(images + 1))
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<QIiQQ3d", 1, 1, 0, WIDTH, HEIGHT, F, WIDTH / 2, HEIGHT / 2))
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", images))
        for k in range(images):
            some = order[starts[k] : starts[k + 1]]
            data = np.zeros(len(some), IMAGE_POINT)
            data["xy"], data["point"] = xy[some], point[some] + 1
            t = -np.array([1, -1, -1]) * camera[k]
            file.write(struct.pack("<I7dI", k + 1, 0, 1, 0, 0, *t, 1) + f"{k:06d}.jpg".encode() + b"\0")
            file.write(struct.pack("<Q", len(data)) + data.tobytes())
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", points))
        for k, xyz in enumerate(place.tolist()):
            file.write(struct.pack("<Qddd3BdQ", k + 1, *xyz, 0, 0, 0, 0.5, SEEN) + bytes(8 * SEEN))


def memory() -> float:
    """Largest memory of the process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Reads a large COLMAP model.")
    parser.add_argument("--rays", type=int, default=2_700_000)
    options = parser.parse_args()
    runtime.start()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_model(folder, options.rays)
        size = sum(path.stat().st_size for path in folder.iterdir()) / 2**20
        before, start = memory(), time.process_time()
        foreign = read_colmap(folder)
        read, after = time.process_time(), memory()
        block = assembled(foreign)
        made = time.process_time()
    print(
        f"{block}: {size:.0f} MiB, read in {read - start:.1f} s of processor time, made a block in {made - read:.1f} s"
    )
    print(f"memory {before:.2f} GiB before, {after:.2f} GiB after reading, {memory():.2f} GiB at last")
    return 0


if __name__ == "__main__":
    sys.exit(main())
