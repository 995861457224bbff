"""Times a gradient through an adjustment: python tests/benchmarks/gradients.py [--block 320]

The block stands at its minimum. The gradient of the sum of squares of all object points by every value of the block is
timed without the iterations that come before it, and given in iterations of the adjustment.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from blocks import SIZES, write_block  # noqa: E402
from table import print_machine  # noqa: E402

import jaxbundle as jb  # noqa: E402
from jaxbundle.solve.implicit import Derivatives  # noqa: E402

KINDS: tuple[Derivatives, ...] = ("gauss-newton", "exact")
REPEATED = 3


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Times a gradient through an adjustment.")
    parser.add_argument("--block", choices=SIZES, default="320")
    size = parser.parse_args().block
    print_machine(None)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "block.txt"
        write_block(file, *SIZES[size])
        block = jb.with_datum(jb.read_bal(file))
    steps = []
    result = jb.adjust(block, precision=False, progress=lambda _: steps.append(time.perf_counter()))
    iteration = statistics.median(np.diff(steps))
    print(f"{size} images, {len(block.structure.ray_image)} rays: one iteration {1e3 * iteration:.0f} ms")
    values, structure = eqx.partition(result.block, eqx.is_inexact_array)
    for kind in KINDS:

        def squares(values: jb.Block, kind: Derivatives = kind) -> jax.Array:
            adjusted = jb.adjust(eqx.combine(values, structure), precision=False, derivatives=kind)
            return jnp.sum(adjusted.block.object_points**2)

        times = []
        for _ in range(REPEATED + 1):  # the first one compiles
            _, back = jax.vjp(squares, values)
            start = time.perf_counter()
            jax.block_until_ready(back(1.0))
            times.append(time.perf_counter() - start)
        spent = statistics.median(times[1:])
        print(
            f"  gradient, {kind:13} {1e3 * spent:6.0f} ms  {spent / iteration:5.1f} iterations; first {times[0]:.1f} s"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
