"""One block in the formats of ten programs: each reading gives the same misfit, and the printed figures come out."""

import dataclasses

import numpy as np
import pytest
from cases.rosetta import OPTIONS, PIX4D, PIXEL, PLACES, half_sum_of_squares, pix4d_folder, rms_at, rosetta

from jaxbundle.block.problems import BlockError
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.collected import transposed
from jaxbundle.io.formats.colmap import read_colmap
from jaxbundle.io.formats.decided import decided
from jaxbundle.io.formats.format_table import read_format, recognised
from jaxbundle.io.formats.micmac import read_micmac
from jaxbundle.io.formats.misfit import misfits, ray_residuals
from jaxbundle.io.formats.opensfm import read_opensfm
from jaxbundle.io.formats.rotations import to_angles

RMS = {  # px, tie rays and rays of control points, as the files that were written tell
    "metashape": (0.311678, 0.923915),
    "blocksexchange": (0.311678, 0.923915),
    "bundler": (0.311678, None),
    "opf": (0.311677, 0.923915),
    "bingo": (0.311642, 0.923909),
}


@pytest.mark.parametrize("name", RMS)
def test_misfit_of_the_one_block(shared_data, name):
    found = misfits(rosetta(shared_data, name))
    unit = PIXEL if name == "bingo" else 1.0
    tie, control = RMS[name]
    assert found.tie.rays == 4019 and found.tie.rms / unit == pytest.approx(tie, abs=2e-6)
    assert not found.tie.behind
    if control:
        assert found.control.rays == 47 and found.control.rms / unit == pytest.approx(control, abs=2e-6)


@pytest.mark.parametrize("name, rms", [("patb", 0.311672), ("inpho", 0.311679)])
def test_formats_without_tie_points_fit_those_of_another(shared_data, name, rms):
    """Their points are numbered from 100000 in the order of BINGO's."""
    foreign, other = rosetta(shared_data, name), rosetta(shared_data, "metashape")
    places = dict(zip((f"{100_000 + k}" for k in range(1166)), other.points.coordinates, strict=False))
    unit = PIXEL if name == "patb" else 1.0
    assert rms_at(foreign, places) / unit == pytest.approx(rms, abs=5e-6)
    found = misfits(decided(foreign))
    assert found.tie.rays == 4019 and 0.310 < found.tie.rms / unit < rms  # intersected, each point has its minimum


@pytest.mark.parametrize("form", PIX4D)
def test_measurements_of_pix4d(shared_data, tmp_path, form):
    folder = pix4d_folder(shared_data, tmp_path / form, form)
    (found,) = recognised(folder)
    foreign, other = read_format(folder, found.name, OPTIONS), rosetta(shared_data, "metashape")
    places = dict(zip(map(str, range(1166)), other.points.coordinates, strict=False))
    assert len(foreign.rays.image) == 4019
    assert rms_at(foreign, places) == pytest.approx(0.3117, abs=5e-5)


@pytest.mark.parametrize("name", PLACES)
def test_formats_are_told_by_content(shared_data, name):
    assert [form.name for form in recognised(shared_data / "exchange" / PLACES[name])] == [name]


def test_orientations_agree_among_all(shared_data):
    first = rosetta(shared_data, "metashape").images
    for name in PLACES:
        images = rosetta(shared_data, name).images
        shift = np.array([1000079.0, 112420.0, 1910.0]) if name == "bundler" else 0.0
        np.testing.assert_allclose(images.centre + shift, first.centre, atol=2e-4)
        np.testing.assert_allclose(images.rotation, first.rotation, atol=3e-9 if name != "bingo" else 2e-8)


@pytest.mark.parametrize(
    "path, cost",
    [
        ("colmap/txt", 11815.702905),
        ("colmap/bin", 11815.423377),
        ("exchange/colmap/rig2_synthetic/txt", 122.212007),
        ("exchange/colmap/rig2_synthetic/bin", 122.212007),
    ],
)
def test_figures_of_colmap(shared_data, path, cost):
    assert half_sum_of_squares(read_colmap(shared_data / path)) == pytest.approx(cost, abs=1e-6)


def test_figures_of_opensfm_and_bundler(shared_data):
    foreign = read_opensfm(shared_data / "exchange" / "opensfm")
    assert half_sum_of_squares(foreign) == pytest.approx(9361.663352, abs=1e-6)
    found = misfits(foreign).tie
    assert (found.rays, found.rms) == (3082, pytest.approx(1.742851, abs=1e-6))
    assert len(foreign.images.names) == 3 and len(foreign.points.names) == 1430
    assert half_sum_of_squares(rosetta(shared_data, "bundler")) == pytest.approx(390.418229, abs=1e-6)


def test_figures_of_micmac(shared_data):
    """40 points that four orientations are verified by: mm of scanned film."""
    v, behind = ray_residuals(read_micmac(shared_data / "exchange" / "micmac" / "Ori-Rel"))
    assert len(v) == 40 and np.abs(v).max() < 2e-14 and not behind.any()
    turned = read_micmac(shared_data / "exchange" / "micmac" / "WPK").images.rotation
    np.testing.assert_allclose(np.degrees(to_angles(turned)), [[11, 2.2, -33.3]], atol=1e-12)


def test_wrong_conventions_move_the_misfit(shared_data):
    """Half a pixel and exchanged decentring raise it, a transposed matrix is refused."""
    foreign = rosetta(shared_data, "blocksexchange")
    right = misfits(foreign).tie.rms
    half = dataclasses.replace(foreign, rays=foreign.rays._replace(xy=foreign.rays.xy + 0.5))
    assert misfits(half).tie.rms > 1.2 * right
    rig = read_colmap(shared_data / "exchange" / "colmap" / "rig2_synthetic" / "txt")
    exchanged = tuple(
        dataclasses.replace(c, elements={**c.elements, "P1": c.elements["P2"], "P2": c.elements["P1"]})
        for c in rig.cameras
    )
    assert misfits(dataclasses.replace(rig, cameras=exchanged)).tie.rms > 1.01 * misfits(rig).tie.rms
    with pytest.raises(BlockError, match="the rays do not fit the orientations of the file .* % of the image; allowed"):
        assembled(transposed(foreign))


def test_readings_are_tried_and_told(shared_data):
    """A transposed matrix is found, and the report says so."""
    foreign = rosetta(shared_data, "patb")
    found = decided(dataclasses.replace(transposed(foreign), reading="turned"))
    words = " ".join(finding.words for finding in found.findings)
    assert "the file was read with the matrix as image from object, which fits best (turned: " in words
    assert misfits(found).tie.rms / PIXEL == pytest.approx(0.3101, abs=1e-4)
