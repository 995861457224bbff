"""The commands that take photographs: what they write and what they refuse."""

import sys

import numpy as np
import pytest
from PIL import Image

from jaxbundle.cli import codes, main, runtime
from jaxbundle.imagery import extra


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a command line in an empty folder; exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runtime, "start", lambda cluster=None: None)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["jaxbundle", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


@pytest.fixture
def image(tmp_path):
    grey = np.random.default_rng(1).integers(0, 256, (300, 400), np.uint8)
    Image.fromarray(grey).save(tmp_path / "a.png")
    return tmp_path / "a.png"


def test_pyramid(run, image):
    assert run("pyramid", image, "--out", "out") == (0, "out/a.png.tif: 400 x 300 px, 2 levels\n", "")
    (image.parent / "b.jpg").write_bytes(b"no image")
    code, out, err = run("pyramid", image, "b.jpg", "c.jpg", "--out", "out")
    assert code == codes.Code.BAD_INPUT
    assert out.startswith("out/a.png.tif")
    assert "2 problems in the images" in err and "c.jpg: does not exist" in err


def test_measure_refuses(run, image):
    assert run("measure")[0] == 2
    assert run("measure", "--refine", "block")[0] == 2
    assert "--remeasure needs --control" in run("measure", image, "--remeasure")[2]
    code, _, err = run("measure", image, "--principal-distance", 400)
    assert (code, "there is one image only; give at least two that overlap" in err) == (2, True)
    (image.parent / "full").mkdir()
    (image.parent / "full" / "x").touch()
    assert "full exists; give the name of a new folder" in run("measure", image, "--out", "full")[2]
    assert "none exists" not in run("measure", "none", "--principal-distance", 400)[2]


def test_missing_package_names_the_extra(run, image, monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(extra.importlib, "import_module", absent)
    with pytest.raises(
        extra.MissingExtraError, match=r"needs the package tifffile.*pip install 'jaxbundle\[measure\]'"
    ):
        extra.required("tifffile")
