"""The command `jaxbundle demo`: adjusts simulated blocks and compares the results with the true values."""

from pathlib import Path

import numpy as np
import typer

from jaxbundle.block.block import Block
from jaxbundle.cli.adjusting import echo_result
from jaxbundle.cli.progress import ProgressLines
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io import write_block_folder
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import Simulation, simulate
from jaxbundle.report.files import write_report
from jaxbundle.report.text import aligned
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment

DIGITAL_CAMERA = AerialCamera(
    principal_distance=100.0,
    width=103.68,
    height=67.824,
    pixel_size=0.006,
    offset=(0.05, -0.03),
    coefficients={"K1": -2e-6, "K2": 1.5e-10},
    estimate=("principal_distance", "x0", "y0", "K1", "K2"),
)


def simulations() -> dict[str, Simulation]:
    """A strip of a film camera between two rows of control, and a block of a digital camera with self-calibration."""
    return {
        "strip": simulate(1, 8, control_sigma=0.05, seed=1),
        "block": simulate(
            3,
            8,
            camera=DIGITAL_CAMERA,
            forward_overlap=0.8,
            side_overlap=0.5,
            control_rows=3,
            points_per_image=80,
            seed=2,
        ),
    }


def run(out: Path) -> int:
    """Simulates, adjusts, writes and prints; 0 if all results can be trusted."""
    lines = ProgressLines()
    trustworthy = True
    for name, simulation in simulations().items():
        write_block_folder(simulation.block, out / name)
        with lines.phase(f"adjusting {name}"):
            adjustment = adjust(simulation.block, progress=lines.iteration)
        found = findings(adjustment, simulation.block)
        write_report(adjustment, out / f"{name}-adjusted", found)
        echo_result(adjustment, found)
        typer.echo(
            "\n".join(["  Adjusted - true values, in standard deviations:", *errors(adjustment, simulation.truth)])
        )
        typer.echo(f"Results: {out / name}-adjusted, from the block in {out / name}\n")
        trustworthy &= adjustment.trustworthy
    return 0 if trustworthy else 1


def errors(adjustment: Adjustment, truth: Block) -> list[str]:
    """True errors of all unknowns divided by their standard deviations, as lines of a table."""
    found, sd = adjustment.block, adjustment.standard_deviations
    turned = np.asarray(found.exterior.angles - truth.exterior.angles)
    kinds = [
        (
            "projection centres",
            found.exterior.projection_centre - truth.exterior.projection_centre,
            sd.projection_centre,
        ),
        ("angles", np.arctan2(np.sin(turned), np.cos(turned)), sd.angles),
        ("interior elements", found.interior.elements - truth.interior.elements, sd.interior),
        ("object points", found.object_points - truth.object_points, sd.object_points),
    ]
    rows = [("", "number", "rms", "largest", "within 2 sd")]
    for kind, error, deviation in kinds:
        unknown = np.asarray(deviation) > 0
        size = np.abs(np.asarray(error)[unknown] / np.asarray(deviation)[unknown])
        if size.size:
            share = f"{np.mean(size < 2):.1%}"
            rows.append((kind, str(size.size), f"{np.sqrt(np.mean(size**2)):.2f}", f"{size.max():.2f}", share))
    return aligned(rows)
