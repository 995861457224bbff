"""How often a start from nothing succeeds: simulated blocks of several kinds with wrong rays.

    python tests/benchmarks/starts.py [--blocks 100] [--wrong 0.3] [--kinds flat,ring] [--seed 0]

A start succeeds when all images are oriented in one system and a bundle adjustment from it ends at the minimum that it
reaches from the true values, with the right rays that the start believes (`cases/plain_bundle.py`). One that does not
succeed and does not say so (`Approximation.complete`, or a finding about images) is counted as silent. Wrong rays are
named or not; right rays that are named are counted too.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from jaxbundle.cli import runtime

runtime.start()

from cases.bare_blocks import KINDS, Bare, C, attitudes, bare, errors, scene  # noqa: E402
from cases.plain_bundle import adjusted  # noqa: E402

import jaxbundle as jb  # noqa: E402

NARROW = 1.5e-4  # 1 - cos of 1 degree: rays of a point that are 2 degrees apart
SAME = 1e-6  # relative difference of two sums of squares at one minimum; another minimum differs by percents


def said(found: jb.orientation.Approximation) -> bool:
    """Whether the start says that images may be wrong."""
    return not found.complete or any(subject.table == "images" for f in found.findings for subject in f.subjects)


def _determined(truth: Bare, s: jb.blocks.Structure, rays: np.ndarray) -> np.ndarray:
    """Points whose rays, of those that are used, meet at an angle: from one station no place is better than another."""
    along = truth.points[s.ray_point] - truth.centre[s.ray_image]
    along = np.where(rays[:, None], along / np.linalg.norm(along, axis=1, keepdims=True), 0.0)
    count = np.bincount(s.ray_point, rays)
    mean = np.stack([np.bincount(s.ray_point, column) for column in along.T], 1) / np.maximum(count, 1)[:, None]
    return (count >= 2) & (1 - np.linalg.norm(mean, axis=1) > NARROW)


def ends_at_the_minimum(found: jb.orientation.Approximation, truth: Bare) -> bool:
    """Whether the bundle from the start ends where it ends from the truth."""
    s, block = found.block.structure, found.block
    rays = ~truth.wrong & ~found.suspect_rays
    rays &= _determined(truth, s, rays)[s.ray_point]
    points, point = np.unique(s.ray_point[rays], return_inverse=True)
    measured = s.ray_image[rays], point, np.asarray(block.rays.coordinates)[rays], C
    start = attitudes(block), np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)[points]
    best = adjusted((truth.rotation, truth.centre, truth.points[points]), *measured)
    return adjusted(start, *measured).squares < (1 + SAME) * best.squares


def main() -> None:
    """Prints one line per kind."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--blocks", type=int, default=100)
    parser.add_argument("--wrong", type=float, default=0.3)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for kind in options.kinds.split(","):
        good, doubted, silent, named, false, spent, worst_angle, worst_off = 0, 0, [], [], [], 0.0, 0.0, 0.0
        for k in range(options.blocks):
            rng = np.random.default_rng([options.seed, KINDS.index(kind), k])
            truth = bare(*scene(kind, rng), options.wrong, rng)
            start = time.process_time()
            found = jb.approximate(truth.block)
            spent += time.process_time() - start
            angle, off = errors(found.block, truth)
            right = found.complete and ends_at_the_minimum(found, truth)
            worst_angle, worst_off = max(worst_angle, np.nanmax(angle)), max(worst_off, np.nanmax(off))
            good += right
            doubted += right and said(found)
            if not right:
                told = "silent" if not said(found) else "told"
                silent += [] if said(found) else [k]
                worst = f"{np.nanmax(angle):.3g} deg, {np.nanmax(off):.3g}" if np.isfinite(angle).any() else "none"
                print(
                    f"  {kind} {k}: {told}, {len(found.loose)} loose, {len(found.parts)} parts, worst {worst}",
                    flush=True,
                )
            named.append(found.suspect_rays[truth.wrong].mean() if truth.wrong.any() else 1.0)
            false.append(found.suspect_rays[~truth.wrong].mean())
        rays = f"wrong rays named {100 * np.mean(named):.1f} %, right rays named {100 * np.mean(false):.1f} %"
        print(
            f"{kind}: {good} of {options.blocks} succeed ({doubted} of them doubted), silent {silent}; {rays};"
            f" worst start {worst_angle:.2f} deg, {100 * worst_off:.1f} % of the distance;"
            f" {spent / options.blocks:.2f} s of processor time per block",
            flush=True,
        )


if __name__ == "__main__":
    main()
