"""Blocks of other programs on the command line."""

import pytest

from jaxbundle.io import read


def test_blocks_of_other_programs(run, tmp_path, shared_data):
    """Read by content, with a table beside it; written by name or suffix, and what is lost is said."""
    rig = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    code, out, _ = run("convert", rig, "block")
    assert code == 0 and "misfit at the values of the file: 480 tie rays: 0.5046 px rms" in out
    code, out, _ = run("convert", "block", "again", "--to", "colmap-text")
    assert code == 0 and out.endswith("Block bin: again\n") and (tmp_path / "again" / "cameras.txt").is_file()
    assert run("convert", "again", "b.xml", "--format", "colmap")[0] == 0
    assert (tmp_path / "b.xml").read_text(encoding="utf-8").count("<TiePoint>") == 60
    assert run("convert", rig, "points.ply")[0] == 0 and (tmp_path / "points.ply").is_file()
    assert run("convert", rig, "x", "--to", "word")[0] == 2
    assert run("convert", rig, "x", "--format", "word")[0] == 2
    assert run("convert", rig, "x", "--image-size", "big")[0] == 2
    assert run("convert", rig, "x", "--interior", "1,2")[0] == 2
    assert run("adjust", rig, "--export", "a.shp")[0] == 2
    assert run("adjust", rig, "--write", "b.xml")[0] == 2  # it exists


def test_an_adjusted_block_goes_back(run, tmp_path, shared_data):
    rig = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    options = ("--no-precision", "--write", "back", "--to", "colmap", "--export", "points.ply")
    said = "Results: results\nExport: points.ply\nnot written (colmap cannot represent it): the datum\n"
    code, out, _ = run("adjust", rig, "--out", "results", *options)
    assert code == 0 and out.endswith(f"{said}Adjusted block: back\n")
    again = read(tmp_path / "back", check_start=False)
    (misfit,) = [finding for finding in again.structure.findings if "misfit" in finding.what]
    assert 480 * 2 * misfit.size**2 == pytest.approx(183.75343, rel=1e-5)  # vTPv of the adjustment
