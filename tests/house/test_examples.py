"""The examples run as they stand, and what they print is right."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.fixture
def printed(capsys):
    """What an example prints; all but the first one run in this process, which has most of their programs."""

    def run(name: str) -> str:
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # as users have it
            runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return run


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_is_short(example):
    assert len(example.read_text().splitlines()) < 80


def test_first_block():
    """In a process of its own, as a user runs it."""
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, ROOT / "examples" / "01_first_block.py"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    out = done.stdout
    assert "converged" in out
    share = re.search(r"(\d+)% of the object coordinates are within 2 standard deviations", out)
    assert share and int(share[1]) >= 90


def test_plain_bundle(printed):
    out = printed("02_plain_bundle.py")
    sigma0 = re.search(r"redundancy 201, sigma0 ([\d.]+)", out)
    assert sigma0 and float(sigma0[1]) == pytest.approx(1, abs=0.15)
    rms = re.search(r"rms ([\d.]+), largest", out)
    assert rms and float(rms[1]) == pytest.approx(1, abs=0.4)


def test_erroneous_control(printed):
    out = printed("04_erroneous_control.py")
    assert len(out.splitlines()) == 2 * 17 + 3
    assert "least squares: v^T v 0.1948 mm^2 is less than the least, 0.2593" in out


def test_own_observation(printed):
    out = printed("03_own_observation.py")
    without, with_lake = (float(sd) for sd in re.findall(r"the lake +sd ([\d.]+)", out))
    assert with_lake < 0.7 * without
    level = re.search(r"level of the lake ([-+][\d.]+) m, sd ([\d.]+)", out)
    assert level and abs(float(level[1])) < 3 * float(level[2])


@pytest.mark.thorough
def test_sensitivity_to_control(printed):
    out = printed("05_sensitivity_to_control.py")
    together = re.search(r"check points by ([\d.]+) to ([\d.]+) m", out)
    assert together and [float(x) for x in together.groups()] == pytest.approx([1, 1], abs=1e-8)
    told, done, off = map(float, re.findall(r"up to ([\d.]+) m", out))
    assert off < 0.01 * min(told, done)


@pytest.mark.thorough
def test_learned_distortion(printed):
    out = printed("06_learned_distortion.py")
    without, learned, true = (float(rms) for rms in re.findall(r"test points +([\d.]+) mm", out))
    assert learned < 1.1 * true < 0.5 * without


@pytest.mark.thorough
def test_tuned_weights(printed):
    out = printed("07_tuned_weights.py")
    said, tuned, true = (float(line.split()[-1]) for line in out.splitlines()[1:])
    assert tuned < said and tuned < 1.1 * true


@pytest.mark.thorough
def test_leave_one_out(printed):
    out = printed("08_leave_one_out.py")
    agreeing = re.search(r"(\d+)% of the rays agree within 5%", out)
    assert agreeing and int(agreeing[1]) >= 95


@pytest.mark.thorough
def test_control_by_derivative(printed):
    out = printed("10_control_by_derivative.py")
    walk = re.search(r"walk against the gradient: ([\d. ]+)", out)
    exchange = re.search(r"exchange over \d+ places: ([\d.]+), lower bound ([\d.]+)", out)
    assert walk and exchange
    values = [float(v) for v in walk[1].split()]
    assert values == sorted(values, reverse=True) and values[-1] < values[0]
    found, bound = map(float, exchange.groups())
    assert bound < found < 1.02 * values[-1]
    assert out.count("C") >= 4


@pytest.mark.thorough
def test_strip_before_the_flight(printed):
    out = printed("11_strip_before_the_flight.py")
    rows = {m[1].strip(): [float(x) for x in m[2].split()] for m in re.finditer(r"(?m)^(\D+?)((?: +[\d.]+){3})$", out)}
    assert rows["free end, bundle"] == pytest.approx([26.52, 20.81, 48.68], abs=0.02)
    assert rows["its cubic in n"] == pytest.approx(rows["free end, bundle"], rel=2e-3)
    assert rows["middle, pairs across the ends, bundle"] == pytest.approx([3.84, 3.90, 13.54], abs=0.02)
    assert rows["middle, single points, bundle"] == pytest.approx([7.84, 6.39, 13.84], abs=0.02)
