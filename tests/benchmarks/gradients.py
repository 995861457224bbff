"""Times a gradient through an adjustment: python tests/benchmarks/gradients.py [--block 320]

The block stands at its minimum. Gradients by every value of the block, of the sum of squares of all object points, with
and without second derivatives of the observations, and of the sum of all points' standard deviations, are timed without
the iterations that come before them, and given in iterations of the adjustment.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from functools import partial
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

REPEATED = 5


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Times a gradient through an adjustment.")
    parser.add_argument("--block", choices=SIZES, default="320")
    size = parser.parse_args().block
    print_machine(None)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "block.txt"
        write_block(file, *SIZES[size])
        block = jb.blocks.with_datum(jb.io.read_bal(file))
    steps = []
    result = jb.adjust(block, precision=False, progress=lambda _: steps.append(time.perf_counter()))
    iteration = statistics.median(np.diff(steps))
    print(f"{size} images, {len(block.structure.ray_image)} rays: one iteration {1e3 * iteration:.0f} ms")
    values, structure = eqx.partition(result.block, eqx.is_inexact_array)

    def adjusted(values: jb.Block, precision: bool, derivatives: Derivatives) -> jb.Adjustment:
        return jb.adjust(eqx.combine(values, structure), precision=precision, derivatives=derivatives)

    def squares(values: jb.Block, derivatives: Derivatives) -> jax.Array:
        return jnp.sum(adjusted(values, False, derivatives).block.object_points ** 2)

    def deviations(values: jb.Block) -> jax.Array:
        cofactors = adjusted(values, True, "exact").cofactors
        assert cofactors is not None
        return jnp.sum(jnp.sqrt(jnp.trace(cofactors.object_points, axis1=1, axis2=2)))

    functions = {
        "points, Gauss-Newton": partial(squares, derivatives="gauss-newton"),
        "points, exact": partial(squares, derivatives="exact"),
        "standard deviations": deviations,
    }
    for name, function in functions.items():
        times = []
        for _ in range(REPEATED + 1):  # the first one compiles
            _, back = jax.vjp(function, values)
            start = time.perf_counter()
            jax.block_until_ready(back(1.0))
            times.append(time.perf_counter() - start)
        spent = statistics.median(times[1:])
        print(f"  {name:22} {1e3 * spent:6.0f} ms  {spent / iteration:5.1f} iterations; first {times[0]:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
