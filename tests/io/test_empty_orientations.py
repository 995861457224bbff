"""Orientations that are not given: they are found from the rays when a folder is read."""

from pathlib import Path

import numpy as np
import pytest
from cases.small_folder import IMAGES, make_small_folder, orientations

import jaxbundle as jb
from jaxbundle.block.findings import Kind, of_kind
from jaxbundle.cli import approximating


@pytest.fixture
def folder(tmp_path) -> Path:
    make_small_folder(tmp_path)
    rows = ["image,camera,X0,Y0,Z0,omega,phi,kappa", *(f"{name},wide,,,,,," for name in IMAGES)]
    (tmp_path / "images.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def test_empty_orientations_are_found(folder):
    block = jb.read(folder)
    np.testing.assert_allclose(block.exterior.projection_centre, orientations()[:, :3], atol=0.5)
    (told,) = of_kind(block.structure.findings, Kind.APPROXIMATED)
    assert "4 images oriented" in told.what


def test_without_a_check_they_stay_unknown(folder):
    block = jb.read(folder, check_start=False)
    assert np.isnan(block.exterior.angles).all()
    with pytest.raises(jb.BlockError, match="image 011 has no orientation"):
        jb.adjust(block)


def test_half_an_orientation_is_an_error(folder):
    table = folder / "images.csv"
    table.write_text(table.read_text().replace("011,wide,,,,,,", "011,wide,1,,2,,,"))
    with pytest.raises(jb.BlockError, match="image 011: Y0"):
        jb.read(folder)


def test_the_command_writes_a_folder(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert approximating.run(folder, out, anew=False) == 0
    assert "4 of 4 images oriented" in capsys.readouterr().out
    block = jb.read(out, check_start=False)
    assert np.isfinite(block.exterior.angles).all()
    with pytest.raises(FileExistsError):
        approximating.run(folder, out, anew=False)
