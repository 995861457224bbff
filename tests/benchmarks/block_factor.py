"""How much farther may control stand in a block than in a strip? The printed factor of 1.5 to 2, for several overlaps.

    python tests/benchmarks/block_factor.py

Control: XYZ in every side lap at both ends of the strips. Reference: one strip of `BASES` bases with two points across
each end. The factor is that length of the block, over the strip's, at which the middle is as precise as the strip's.
"""

import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]
from cases.schematic_flights import UNIT  # noqa: E402

from jaxbundle.cli import runtime  # noqa: E402
from jaxbundle.planning.flight import ControlSet, schematic  # noqa: E402
from jaxbundle.planning.prediction import predict  # noqa: E402
from jaxbundle.planning.simulation import simulate_flight  # noqa: E402

BASES = {0.6: (12, 18, 26), 0.8: (24, 36, 52)}  # the first one is the strip's
STRIPS = (2, 4, 6)


def middle(strips: int, bases: int, forward: float, side: float) -> np.ndarray:
    """Root mean squares of X, Y, Z over the column in the middle, in sigma0 m."""
    control = (ControlSet("chains", every=bases),)
    plan = schematic(strips=strips, images=bases + 1, forward_overlap=forward, side_overlap=side, control=control)
    truth = simulate_flight(plan).truth
    x = np.asarray(truth.object_points)[:, 0]
    column = np.abs(x - np.unique(np.round(x, 3))[(bases + 1) // 2]) < 1
    return np.sqrt((np.asarray(predict(truth).standard_deviations.object_points)[column] ** 2).mean(0)) / UNIT


def main() -> None:
    """Prints the table."""
    runtime.start()
    print("forward side strips   X    Y    Z")
    for forward, bases in BASES.items():
        reference = middle(1, bases[0], forward, 0.2)
        for side in (0.2, 0.6):
            for strips in STRIPS:
                found = np.array([middle(strips, n, forward, side) for n in bases])
                factors = [
                    np.exp(np.interp(np.log(reference[k]), np.log(found[:, k]), np.log(bases))) / bases[0]
                    for k in range(3)
                ]
                print(f"{forward:5.0%} {side:6.0%} {strips:5}  " + " ".join(f"{f:4.2f}" for f in factors), flush=True)


if __name__ == "__main__":
    main()
