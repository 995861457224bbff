"""The command line in one process of several, each with one device: FILE ARGUMENTS... FILE gets what was found.

The tiles are dealt to all devices, as those of a large block are.
"""

import dataclasses
import sys
from typing import Any

import jax
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.cli import adjusting, main, runtime
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.options import Options


def found(adjustment: Adjustment) -> dict[str, np.ndarray]:
    """What is compared."""
    block, sd = adjustment.block, adjustment.standard_deviations
    assert adjustment.redundancy_numbers is not None
    return {
        "sigma0": np.asarray(adjustment.sigma0),
        "points": np.asarray(block.object_points),
        "centres": np.asarray(block.exterior.projection_centre),
        "elements": np.asarray(block.interior.elements),
        "residuals": np.asarray(adjustment.residuals[0]),
        "sd points": np.asarray(sd.object_points),
        "sd centres": np.asarray(sd.projection_centre),
        "redundancy": np.asarray(adjustment.redundancy_numbers[0]),
    }


def on_all_devices(file: str):
    """`adjust` on the devices of all processes, which writes what it found."""

    def adjusted(block: Block, options: Options, **others) -> Adjustment:
        adjustment = adjust(block, dataclasses.replace(options, devices=jax.device_count()), **others)
        values: dict[str, Any] = found(adjustment)
        np.savez(file, **values)
        return adjustment

    return adjusted


if __name__ == "__main__":
    adjusting.adjust = on_all_devices(sys.argv.pop(1))
    runtime.MAX_DEVICES = 1
    main.main()
