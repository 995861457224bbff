"""Measured blocks against the results of independent programs."""

import json
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.block.problems import BlockError
from jaxbundle.block.residuals import observations_of, weighted_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.io import read, read_bal
from jaxbundle.report import write_report
from jaxbundle.solve.adjust import adjust

PRINTED = {
    "strasbourg-s1-fixed": (94, 30, "1.0419"),
    "strasbourg-s2-weighted": (142, 78, "0.984904"),
    "strasbourg-s4-tie": (2440, 1173, "1.07447"),
    "camcal-c1-fixed": (4148, 414, "1.78095"),
    "camcal-c2-weighted": (4160, 426, "1.60984"),
    "camcal-selfcal-3": (4148, 423, "1.6148"),
}


@pytest.mark.parametrize("name", PRINTED)
def test_block_agrees_with_its_reference(name: str, shared_data: Path, tmp_path: Path) -> None:
    result = adjust(read(shared_data / name))
    observations, unknowns, sigma0 = PRINTED[name]
    assert (result.observations, result.unknowns) == (observations, unknowns)
    assert f"{float(result.sigma0):.{len(sigma0) - 2}f}" == sigma0
    assert result.trustworthy
    write_report(result, tmp_path / "out")
    check = [sys.executable, shared_data / "check.py", shared_data / name, tmp_path / "out" / "report.json"]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    if name == "camcal-selfcal-3":
        k2, k3 = (result.block.structure.cameras[0].model.elements.index(k) for k in ("K2", "K3"))
        assert f"{100 * float(result.interior_correlations[0, k2, k3]):.1f}" == "-97.9"


def test_roma(shared_data: Path, tmp_path: Path) -> None:
    block = read(shared_data / "roma")
    start = weighted_residuals(unknowns_of(block), observations_of(block))
    assert f"{float(jnp.sqrt(sum(jnp.sum(v * v) for v in start))):.2f}" == "8641.39"
    result = adjust(block)
    assert (result.observations, result.unknowns, result.redundancy) == (181122, 79321, 101801)
    assert f"{float(result.sigma0):.6f}" == "0.582769"
    write_report(result, tmp_path / "out")
    check = [sys.executable, shared_data / "check.py", shared_data / "roma", tmp_path / "out" / "report.json"]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    report = json.loads((tmp_path / "out" / "report.json").read_text())["cameras"]["EOS5DMarkII"]
    expected = json.loads((shared_data / "roma" / "expected.json").read_text())["cameras"]["EOS5DMarkII"]
    for element, (value, sd) in expected.items():
        assert abs(report[element][0] - value) <= 1e-4 * sd
        assert abs(report[element][1] / sd - 1) <= 1e-4


@pytest.mark.parametrize(
    ("file", "estimate_interior", "minimum"),
    [
        ("problem-49-7776-pre.txt", True, 1.33442404e4),
        ("problem-49-7776-pre.txt", False, 1.63672734e4),
        ("ladybug-49-shrink-1800.txt", True, 3001.3590784),
        ("ladybug-49-shrink-1800.txt", False, 3581.1631666),
    ],
)
def test_bal_reaches_the_minimum(file: str, estimate_interior: bool, minimum: float, shared_data: Path) -> None:
    result = adjust(read_bal(shared_data / "bal" / file, estimate_interior=estimate_interior), precision=False)
    expected = json.loads((shared_data / "bal" / "expected.json").read_text())["files"][file]
    assert float(result.iterations.initial_cost) == pytest.approx(expected["initial_cost"], rel=1e-12)
    assert float(result.vtpv) / 2 == pytest.approx(minimum, rel=1e-8)
    datum = result.block.structure.datum
    assert datum.kind == "minimal"
    assert len(datum.held) == 7
    assert np.isfinite(result.residuals[0]).all()


def test_more_unknowns_than_observations_are_refused(shared_data: Path) -> None:
    with pytest.raises(BlockError, match="38 observations do not exceed 48 unknowns"):
        adjust(read_bal(shared_data / "bal" / "dubrovnik-3-7-pre.txt"))
