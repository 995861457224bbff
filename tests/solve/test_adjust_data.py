"""Adjustments of real blocks against published and independently computed results."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read, read_bal
from jaxbundle.report import write_report
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status

BLOCKS = {
    # name: observations, unknowns, sigma0 as quoted
    "strasbourg-s1-fixed": (94, 30, 1.0419),
    "strasbourg-s2-weighted": (142, 78, 0.984904),
    "strasbourg-s4-tie": (2440, 1173, 1.07447),
    "camcal-c1-fixed": (4148, 414, 1.78095),
    "camcal-c2-weighted": (4160, 426, 1.60984),
    "camcal-selfcal-3": (4148, 423, 1.6148),
    "roma": (181122, 79321, 0.582769),
}


def digits(quoted: float) -> float:
    """Half a unit of the last digit of a quoted number."""
    return 0.5 * 10.0 ** -len(f"{quoted!r}".partition(".")[2])


def assert_as_expected(adjustment: Adjustment, folder: Path, out: Path) -> None:
    """The report.json of the adjustment, judged by the script that lies beside the data."""
    report = write_report(adjustment, out) / "report.json"
    judge = [sys.executable, folder.parent / "check.py", folder, report]
    judged = subprocess.run(judge, capture_output=True, text=True)
    assert judged.returncode == 0, judged.stdout + judged.stderr


# the last block of camcal is the same with more unknowns; roma is large
THOROUGH = ("camcal-c1-fixed", "camcal-c2-weighted", "roma")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.thorough) if name in THOROUGH else name for name in BLOCKS]
)
def test_block_folders(shared_data, tmp_path, name):
    """Every value, standard deviation and count of expected.json."""
    observations, unknowns, sigma0 = BLOCKS[name]
    adjustment = adjust(read(shared_data / name))
    assert adjustment.trustworthy
    assert (adjustment.n_observations, adjustment.n_unknowns) == (observations, unknowns)
    assert adjustment.redundancy == observations - unknowns
    assert float(adjustment.sigma0) == pytest.approx(sigma0, abs=digits(sigma0))
    assert_as_expected(adjustment, shared_data / name, tmp_path / "report")
    if name == "camcal-selfcal-3":
        elements = adjustment.block.structure.cameras[0].model.elements
        correlation = adjustment.interior_correlations[0, elements.index("K2"), elements.index("K3")]
        assert float(correlation) == pytest.approx(-0.979, abs=5e-4)
    if name == "roma":
        assert math.sqrt(2 * float(adjustment.iterations.initial_cost)) == pytest.approx(8641.39, abs=5e-3)
        assert math.sqrt(float(adjustment.vtpv)) == pytest.approx(185.93972, abs=5e-6)


@pytest.mark.parametrize(
    "estimate_interior",
    [pytest.param(True, id="free interior", marks=pytest.mark.thorough), pytest.param(False, id="held interior")],
)
def test_ladybug(shared_data, estimate_interior):
    """The seven elements of the datum are chosen; the minimum does not depend on them."""
    file = "problem-49-7776-pre.txt"
    expected = json.loads((shared_data / "bal" / "expected.json").read_text())["files"][file]
    adjustment = adjust(read_bal(shared_data / "bal" / file, estimate_interior), precision=False)
    assert float(adjustment.iterations.initial_cost) == pytest.approx(expected["initial_cost"], rel=1e-12)
    minimum = expected["minimum_cost" if estimate_interior else "minimum_cost_fixed_interior"]
    assert float(adjustment.vtpv) / 2 <= minimum * (1 + 1e-8)
    # with a free interior the rays of a few points become parallel: these are named, as all else is determined
    assert adjustment.status is Status.CONVERGED
    undetermined = [subject.table for finding in adjustment.failures for subject in finding.subjects]
    assert undetermined == ["points"] * len(undetermined) and len(undetermined) <= (20 if estimate_interior else 0)
    datum = adjustment.block.structure.datum
    assert datum.kind == "minimal" and len(datum.held) == 7 and str(datum).startswith("minimal")
    assert adjustment.n_unknowns == np.sum([49 * 6, 49 * 3 * estimate_interior, 7776 * 3]) - 7


def test_dubrovnik_is_refused(shared_data):
    with pytest.raises(BlockError, match="38 observations do not exceed 48 unknowns"):
        adjust(read(shared_data / "bal" / "dubrovnik-3-7-pre.txt"))
