"""One process of several that adjust the same block: ADDRESS PROCESSES PROCESS FILE SEED.

Writes what each solver found. Any failure ends the process at once: JAX would keep it waiting for the others.
"""

import os
import sys
import traceback
from pathlib import Path

import jax
import numpy as np
from cases.simulated_blocks import long_block

from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment

SOLVERS = ("panels", "dense")


def found(adjustment: Adjustment) -> dict[str, np.ndarray]:
    """What is compared."""
    block = adjustment.block
    values = {
        "sigma0": np.asarray(adjustment.sigma0),
        "points": np.asarray(block.object_points),
        "centres": np.asarray(block.exterior.projection_centre),
        "elements": np.asarray(block.interior.elements),
        "residuals": np.asarray(adjustment.residuals[0]),
    }
    if adjustment.redundancy_numbers is not None:
        sd = adjustment.standard_deviations
        values |= {"sd points": np.asarray(sd.object_points), "sd centres": np.asarray(sd.projection_centre)}
        values |= {"redundancy": np.asarray(adjustment.redundancy_numbers[0])}
    return values


def main(address: str, processes: str, process: str, file: str, seed: str) -> None:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 1)
    jax.distributed.initialize(address, int(processes), int(process), initialization_timeout=30)
    block = long_block(int(seed)).block
    results = {}
    for solver in SOLVERS:
        adjustment = adjust(block, devices=jax.device_count(), reduced=solver, precision=solver == "panels")
        results |= {f"{solver} {name}": value for name, value in found(adjustment).items()}
    np.savez(Path(file), **results)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
