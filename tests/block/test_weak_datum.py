"""A shift that all stations share leaves the position of a block weak, but not its shape."""

import pytest

from jaxbundle.block.datum import with_datum
from jaxbundle.block.datum_precision import weak_datum
from jaxbundle.block.findings import Severity
from jaxbundle.cli import pages
from jaxbundle.io import read


@pytest.mark.parametrize(("sigma", "severity"), [(0.3, Severity.CHECK), (60.0, Severity.FAILED)])
def test_a_shift_is_checked_and_a_weak_shape_fails(tmp_path, sigma, severity):
    folder = tmp_path / "quarry"
    pages.new(folder)
    images = [row.split(",") for row in (folder / "images.csv").read_text().splitlines()[1:]]
    rows = [f"{name},{x},{y},{z},{sigma},{sigma},{sigma},receiver" for name, _, x, y, z, *_ in images]
    (folder / "stations.csv").write_text("\n".join(["image,X,Y,Z,sX,sY,sZ,group", *rows]) + "\n")
    toml = (folder / "block.toml").read_text().replace('control = "control.csv"', 'stations = "stations.csv"')
    navigation = '[navigation.receiver]\nestimate = ["shift"]\npriors = { shift = 50.0 }\n\n[tables]'
    (folder / "block.toml").write_text(toml.replace("[tables]", navigation))
    (folder / "control.csv").unlink()
    (found,) = weak_datum(with_datum(read(folder, check_start=False)), 1.0)
    assert found.severity is severity
