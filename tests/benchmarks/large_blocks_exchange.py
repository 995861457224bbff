"""Reads a large BlocksExchange file: python tests/benchmarks/large_blocks_exchange.py [--megabytes 1000]

A file of that size, of photographs in strips and tie points seen by four of them, is written to a temporary folder and
deleted afterwards; printed are the time and the memory of reading it.
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxbundle.io.formats.blocks_exchange import read_blocks_exchange

PHOTOS, SEEN, WIDTH, HEIGHT, F = 1000, 4, 4000, 3000, 3000.0
BASE, ABOVE, ROWS = 5.0, 100.0, 10_000
HEAD = (
    '<?xml version="1.0" encoding="utf-8"?><BlocksExchange version="2.1"><Block><Photogroups><Photogroup>'
    f"<ImageDimensions><Width>{WIDTH}</Width><Height>{HEIGHT}</Height></ImageDimensions>"
    f"<FocalLengthPixels>{F}</FocalLengthPixels>"
)
TURNED = "<M_00>1</M_00><M_01>0</M_01><M_02>0</M_02><M_10>0</M_10><M_11>-1</M_11><M_12>0</M_12>"
TURNED += "<M_20>0</M_20><M_21>0</M_21><M_22>-1</M_22>"


def write_file(path: Path, size: int) -> int:
    """Photographs looking down on a line, and rows of tie points until the file has its size; the number of rays."""
    rng, rays = np.random.default_rng(0), 0
    with path.open("w", encoding="utf-8") as file:
        file.write(HEAD)
        for k in range(PHOTOS):
            centre = f"<Center><x>{k * BASE}</x><y>0</y><z>{ABOVE}</z></Center>"
            pose = f"<Pose><Rotation>{TURNED}</Rotation>{centre}</Pose>"
            file.write(f"<Photo><Id>{k}</Id><ImagePath>{k:05d}.jpg</ImagePath>{pose}</Photo>")
        file.write("</Photogroup></Photogroups><TiePoints>")
        while file.tell() < size:
            first = rng.integers(0, PHOTOS - SEEN, ROWS)
            place = np.c_[(first + SEEN / 2) * BASE + rng.uniform(-5, 5, ROWS), rng.uniform(-40, 40, ROWS)]
            for start, (x, y) in zip(first.tolist(), place.tolist(), strict=True):
                file.write(f"<TiePoint><Position><x>{x:.6f}</x><y>{y:.6f}</y><z>0.0</z></Position>")
                for k in range(start, start + SEEN):
                    u, v = WIDTH / 2 - 0.5 + F * (x - k * BASE) / ABOVE, HEIGHT / 2 - 0.5 - F * y / ABOVE
                    file.write(f"<Measurement><PhotoId>{k}</PhotoId><x>{u:.4f}</x><y>{v:.4f}</y></Measurement>")
                file.write("</TiePoint>\n")
            rays += SEEN * ROWS
        file.write("</TiePoints></Block></BlocksExchange>")
    return rays


def memory() -> float:
    """Largest memory of the process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Reads a large BlocksExchange file.")
    parser.add_argument("--megabytes", type=int, default=1000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "large.xml"
        rays = write_file(path, options.megabytes * 1_000_000)
        before, start = memory(), (time.process_time(), time.perf_counter())
        foreign = read_blocks_exchange(path)
        seconds = time.process_time() - start[0], time.perf_counter() - start[1]
        size = path.stat().st_size / 1e6
    assert len(foreign.rays.image) == rays
    print(
        f"{size:.0f} MB, {len(foreign.points.names)} points, {rays} rays: {seconds[0]:.0f} s of processor time,",
        end=" ",
    )
    print(f"{seconds[1]:.0f} s; memory {before:.2f} GiB before, {memory():.2f} GiB at last")
    return 0


if __name__ == "__main__":
    sys.exit(main())
