"""How often a start from nothing succeeds: simulated blocks of several kinds with wrong rays.

    python tests/benchmarks/starts.py [--blocks 100] [--wrong 0.3] [--kinds flat,ring] [--seed 0]

A start succeeds when all images are oriented in one system, with attitudes within 2 degrees and centres within 5 % of
the mean distance of the points: the adjustment converges from there. One that does not succeed and does not say so
(`Approximation.complete`) is counted as silent. Wrong rays are named or not; right rays that are named are counted too.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from jaxbundle.cli import runtime

runtime.start()

from cases.bare_blocks import KINDS, bare, errors, scene  # noqa: E402

import jaxbundle as jb  # noqa: E402

MAX_ANGLE, MAX_OFF = 2.0, 0.05


def main() -> None:
    """Prints one line per kind."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--blocks", type=int, default=100)
    parser.add_argument("--wrong", type=float, default=0.3)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for kind in options.kinds.split(","):
        good, silent, named, false, spent = 0, [], [], [], 0.0
        for k in range(options.blocks):
            rng = np.random.default_rng([options.seed, KINDS.index(kind), k])
            truth = bare(*scene(kind, rng), options.wrong, rng)
            start = time.process_time()
            found = jb.approximate(truth.block)
            spent += time.process_time() - start
            angle, off = errors(found.block, truth)
            right = bool(found.complete and angle.max() < MAX_ANGLE and off.max() < MAX_OFF)
            good += right
            if not right:
                told = "told" if not found.complete else "silent"
                silent += [k] if found.complete else []
                worst = f"{np.nanmax(angle):.3g} deg, {np.nanmax(off):.3g}" if np.isfinite(angle).any() else "none"
                print(
                    f"  {kind} {k}: {told}, {len(found.loose)} loose, {len(found.parts)} parts, worst {worst}",
                    flush=True,
                )
            named.append(found.suspect_rays[truth.wrong].mean() if truth.wrong.any() else 1.0)
            false.append(found.suspect_rays[~truth.wrong].mean())
        rays = f"wrong rays named {100 * np.mean(named):.1f} %, right rays named {100 * np.mean(false):.1f} %"
        print(
            f"{kind}: {good} of {options.blocks} succeed, silent {silent}; {rays};"
            f" {spent / options.blocks:.2f} s of processor time per block",
            flush=True,
        )


if __name__ == "__main__":
    main()
