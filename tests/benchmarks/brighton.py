"""From 18 photographs of a small aircraft to an adjusted block: python tests/benchmarks/brighton.py [--block FOLDER]

Measures ../shared/data/images/brighton (or takes a block folder measured before), finds the orientations from the rays,
adjusts with self-calibration and robust weights, once with the standard deviations of matching and once with equal
ones, and prints time, memory, rays, sigma0 and the interior elements.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxbundle.cli import runtime

runtime.start()

import jaxbundle as jb  # noqa: E402

DATA = Path(__file__).parents[3] / "shared" / "data" / "images" / "brighton"
SENSOR_WIDTH, FOCAL, COLUMNS = 6.17, 3.61, 2000  # mm, mm, px


def measured() -> Path:
    """The block folder of the photographs."""
    began = time.perf_counter()
    folder = Path(tempfile.mkdtemp()) / "brighton"
    camera = jb.measuring.CameraGiven(principal_distance=FOCAL / SENSOR_WIDTH * COLUMNS)
    options = jb.measuring.MeasureOptions(camera=camera, pyramids=folder.parent / "pyramids")
    positions = jb.measuring.read_positions(DATA / "gps.csv")
    jb.measuring.measure(sorted(DATA.glob("*.jpg")), folder, options, positions=positions)
    print(f"measured in {time.perf_counter() - began:.0f} s: {folder}")
    return folder


def main() -> None:
    """Measures, adjusts, prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--block", type=Path)
    block = jb.read(parser.parse_args().block or measured())
    matched = np.asarray(block.rays.sigmas)
    for weights, sigmas in (("of matching", matched), ("equal", np.full_like(matched, np.median(matched)))):
        began = time.perf_counter()
        result = jb.adjust(block.replace(sigmas={"rays": sigmas}), robust=jb.robust.Huber())
        v = np.asarray(result.residuals[0])
        print(
            f"weights {weights}: {time.perf_counter() - began:.0f} s, {result.message}, sigma0"
            f" {float(result.sigma0):.3f}, rms {np.sqrt(np.mean(v**2)):.3f} px, robust"
            f" {1.4826 * np.median(np.abs(v)):.3f} px\n  interior {dict(result.cameras['camera'])}"
        )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
