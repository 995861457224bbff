"""`jaxbundle plan`: what it prints and writes, and its exit codes."""

import json
import sys
from xml.etree import ElementTree

import pytest

from jaxbundle.cli import main, runtime
from jaxbundle.io import read, read_block_folder

FLIGHT = """
name = "strip"
[camera]
name = "film-153"
[flight]
height = 1500
strips = 1
images = 3
headings = [70]
[ties]
points_per_image = 12
[[control]]
layout = "corners"
sigma = [0.05, 0.05, 0.08]
[gross_errors]
share = 0.02
[specification]
xy = 0.5
z = {z}
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a command line in a folder with flight.toml; exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runtime, "start", lambda cluster=None: None)  # it sets JAX up for the whole process

    def call(*arguments, z=1.0):
        (tmp_path / "flight.toml").write_text(FLIGHT.format(z=z))
        monkeypatch.setattr(sys, "argv", ["jaxbundle", "plan", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


def test_laws(run):
    setup = ("--scale", 10000, "--parallax", 0.01, "--principal-distance", 70, "--base", 70)
    code, out, _ = run("laws", *setup, "--tolerance", 0.8, 0.5, 0.8)
    assert code == 0
    assert "printed: control every 9 stereopairs, 6.30 km; in a block, by the printed factor 1.5 to 2, 9.45 to" in out
    assert "predicted X Y Z 0.743 0.385 0.628 m" in out and "printed 0.58 n^1.5 18.34 (-6.5%)" in out
    code, _, err = run("laws", "--base", 0)
    assert code == 2 and "base is 0.0; give a positive number" in err


def test_a_flight_is_predicted(run, tmp_path):
    code, out, _ = run("flight.toml", "--out", "plan")
    assert code == 0 and "The flight meets the specification X, Y 0.5 m, Z 1 m at 95% of the points" in out
    found = json.loads((tmp_path / "plan" / "prediction.json").read_text())
    assert found["specification"]["passed"] and found["control_points"] == 4 and found["undetermined"] == []
    for name in ("sigma_XY.svg", "sigma_Z.svg"):
        svg = ElementTree.parse(tmp_path / "plan" / name).getroot()
        circles = svg.findall("{http://www.w3.org/2000/svg}circle")
        assert len(circles) == found["judged_points"] + 6 + 1  # the legend and the ring
    assert (tmp_path / "plan" / "points.csv").read_text().startswith("point,X,Y,Z,sX,sY,sZ,rays,control\n")
    code, out, _ = run("flight", "flight.toml", "--out", "plan", z=1e-3)
    assert code == 1 and "does not meet the specification" in out


def test_a_flight_is_simulated(run, tmp_path):
    code, out, _ = run("simulate", "flight.toml", "--out", "made")
    assert code == 0 and "Block: made/block, truth: made/truth" in out
    block, truth = read(tmp_path / "made" / "block"), read_block_folder(tmp_path / "made" / "truth")
    assert block.structure.point_names == truth.structure.point_names
    lines = (tmp_path / "made" / "gross_errors.csv").read_text().splitlines()
    assert len(lines) == 1 + round(0.02 * len(block.structure.ray_image))


def test_wrong_flights_end_with_code_2(run):
    code, _, err = run("nowhere.toml")
    assert code == 2 and "nowhere.toml: there is no such file; give the path" in err
    code, _, err = run("sensitivity", "nowhere", "--point", "1")
    assert code == 2


@pytest.mark.thorough
def test_control_is_placed(run, tmp_path):
    code, out, _ = run("control", "flight.toml", "--points", 2, "--sigma", 0.02, 0.02, 0.02, "--out", "control")
    assert code == 0 and "2 control points" in out and "no layout with this number of positions is better by" in out
    assert len((tmp_path / "control" / "control.csv").read_text().splitlines()) == 3
    code, out, _ = run("control", "flight.toml", "--sigma", 0.01, 0.01, 0.01)
    assert code == 0 and "1 control point" in out and "the specification is met" in out


@pytest.mark.thorough
def test_what_moves_a_point_is_told(run, tmp_path):
    run("simulate", "flight.toml", "--out", "made")
    code, out, _ = run("sensitivity", "made/truth", "--point", "7", "--out", "effects.csv")
    assert code == 0 and "Z of point 7" in out and "principal_distance of camera (cameras) [mm]" in out
    assert "point 7" in (tmp_path / "effects.svg").read_text()
