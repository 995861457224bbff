"""Inner orientation: the fits themselves, and a block of scanned film against the same block in mm."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from cases.scanned_film import CALIBRATED, CAMERA, NAMES, PIXEL, TRUE, by, film_folder, image_transformation, rays
from cases.small_folder import IMAGES, change, image_coordinates, make_small_folder, write
from scipy.optimize import least_squares

from jaxbundle.camera.fiducials import PARAMETERS, FiducialError, InnerOrientation, inner_orientation
from jaxbundle.io import read_block_folder, write_block_folder
from jaxbundle.report import report_dict, report_text, write_report
from jaxbundle.solve.adjust import adjust


def scanned(matrix, noise=0.0, seed=0):
    """The fiducials in px of a film that this matrix brings to mm."""
    return by(np.linalg.inv(matrix), CALIBRATED) + noise * np.random.default_rng(seed).standard_normal((8, 2))


def fit(transformation, scan, calibrated=CALIBRATED) -> InnerOrientation:
    return inner_orientation("012", transformation, NAMES[: len(scan)], scan, calibrated)


# One image


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("count", [4, 8])
def test_exact_fiducials_give_their_transformation(name, count):
    found = fit(name, scanned(TRUE[name])[:count], CALIBRATED[:count])
    np.testing.assert_allclose(found.matrix, TRUE[name], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-12)
    points = np.array([[12.5, 3800.0], [2200.0, 40.0]])
    np.testing.assert_allclose(found.to_mm(points), by(TRUE[name], points), atol=1e-11)
    assert found.redundancy == 2 * count - len(PARAMETERS[name])


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_fit_minimises_the_discrepancies_in_mm(name):
    """Against a general least-squares solver on the formulas as they stand."""
    scan = scanned(TRUE[name], 0.4)

    def formulas(p):
        given = dict(zip(PARAMETERS[name], p * scale, strict=True))
        if name == "conformal":
            given |= {"b1": given["a2"], "b2": -given["a1"]}
        u, v = scan.T
        w = 1 + given.get("c1", 0.0) * u + given.get("c2", 0.0) * v
        x = (given["a0"] + given["a1"] * u + given["a2"] * v) / w
        y = (given["b0"] + given["b1"] * u + given["b2"] * v) / w
        return np.c_[x, y]

    scale = np.array([1.0 if p in ("a0", "b0") else 1e-6 if p[0] == "c" else 1e-3 for p in PARAMETERS[name]])
    found = fit(name, scan)
    start = np.array(list(fit(name, scanned(TRUE[name])).parameters.values())) / scale
    best = least_squares(lambda p: (formulas(p) - CALIBRATED).ravel(), start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    parameters = np.array(list(found.parameters.values()))
    np.testing.assert_allclose(formulas(parameters / scale) - CALIBRATED, found.residuals, atol=1e-12)
    assert (found.residuals**2).sum() == pytest.approx(2 * best.cost, rel=1e-12)
    np.testing.assert_allclose(parameters / scale, best.x, rtol=1e-5, atol=1e-6)
    assert found.sigma0 == pytest.approx(np.sqrt(2 * best.cost / (16 - len(parameters))), rel=1e-12)
    assert found.worst == np.argmax((found.residuals**2).sum(1))


@pytest.mark.parametrize("name, few", [("conformal", 2), ("affine", 3), ("projective", 4)])
def test_the_fewest_fiducials_leave_no_redundancy(name, few):
    found = fit(name, scanned(TRUE[name], 0.4)[:few], CALIBRATED[:few])
    assert found.redundancy == 0 and np.isnan(found.sigma0)
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-12)
    what = f"image 012 has {few - 1} fiducials?, too few for the {name} transformation; measure at least {few}"
    with pytest.raises(FiducialError, match=what):
        fit(name, scanned(TRUE[name])[: few - 1], CALIBRATED[: few - 1])


@pytest.mark.parametrize(
    "name, which, where",
    [
        ("conformal", [0, 0, 0], "at one position"),
        ("affine", [4, 5, 4, 5], "on a straight line"),
        ("projective", [0, 2, 4, 1], "three on one line"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_fiducials_that_determine_nothing(name, which, where, noise):
    round_ones = np.round(CALIBRATED)[which]
    scan = by(np.linalg.inv(TRUE["affine"]), round_ones)
    scan += noise * np.random.default_rng(1).standard_normal(scan.shape)
    with pytest.raises(FiducialError, match=f"do not determine the {name} transformation: they lie {where}; measure"):
        fit(name, scan, round_ones)


def test_a_projective_fit_that_has_none():
    """Names interchanged: the calibrated quadrangle crosses itself, and no projective transformation is near."""
    with pytest.raises(FiducialError, match="of image 012 does not converge; correct their coordinates or names"):
        fit("projective", scanned(TRUE["affine"])[:4], CALIBRATED[[0, 2, 1, 3]])


# A block


def mm_folder(folder: Path, film: Path) -> Path:
    """The same block in mm: fits by numpy on the formula of the format, sigmas times the pixel."""
    make_small_folder(folder)
    scan = pl.read_csv(film / "rays.csv")["x", "y"].to_numpy().reshape(4, 12, 2)
    measured = pl.read_csv(film / "fiducial_rays.csv")["x", "y"].to_numpy().reshape(4, 8, 2)
    mm = []
    for points, fiducials in zip(scan, measured, strict=True):
        a = np.linalg.lstsq(np.c_[np.ones(8), fiducials], CALIBRATED, rcond=None)[0]
        mm.append(np.c_[np.ones(12), points] @ a)
    write(folder, "rays.csv", "image,point,x,y,sx,sy", rays(np.concatenate(mm)))
    text = (folder / "block.toml").read_text().replace('"px"', '"mm"').replace("image = 0.5", "image = 0.005")
    start, end = text.index("pixel_size"), text.index("[sigma]")
    (folder / "block.toml").write_text(text[:start] + CAMERA.replace("pixel_size = 0.01\n", "") + text[end:])
    return folder


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film_folder(tmp_path_factory.mktemp("film") / "small")


def test_film_becomes_a_camera_in_mm(film: Path) -> None:
    block = read_block_folder(film)
    camera = block.structure.cameras[0]
    assert (camera.image_unit, camera.principal_distance_in_mm) == ("mm", False)
    np.testing.assert_array_equal(block.interior.elements, [[50.0, 0.1, -0.2, 1.0, 1.0]])
    np.testing.assert_allclose(block.rays.sigmas, 0.5 * PIXEL, rtol=1e-15)
    fits = block.structure.inner_orientations
    assert [f.image for f in fits] == list(IMAGES)
    assert all(f.transformation == "affine" and f.fiducials == NAMES and f.redundancy == 10 for f in fits)
    for k, found in enumerate(fits):
        np.testing.assert_allclose(found.matrix[:2, :2], image_transformation(k)[:2, :2], atol=3e-6)
        assert 0.3 * 0.5 < found.sigma0 / PIXEL < 0.3 * 1.6


def test_without_noise_the_rays_are_those_of_the_camera(tmp_path: Path) -> None:
    block = read_block_folder(film_folder(tmp_path / "exact", noise=0.0))
    mm = (image_coordinates() - [3010.0, 2490.0]) * [PIXEL, -PIXEL] + [0.1, -0.2]
    np.testing.assert_allclose(block.rays.coordinates, mm, atol=1e-11)


def test_sigmas_of_single_rays_are_in_px(film: Path, tmp_path: Path) -> None:
    folder = film_folder(tmp_path / "small")
    change(folder, "rays.csv", 3, ",,", ",0.7,")
    np.testing.assert_allclose(read_block_folder(folder).rays.sigmas[1], [0.7 * PIXEL, 0.5 * PIXEL], rtol=1e-15)


def test_adjusted_as_the_same_block_in_mm(film: Path, tmp_path: Path) -> None:
    """sigma0, unknowns, standard deviations and residuals over the pixel; then the report tells of the fits."""
    adjustment = adjust(read_block_folder(film))
    expected = adjust(read_block_folder(mm_folder(tmp_path / "mm", film)))
    assert adjustment.n_observations == expected.n_observations == 102 and adjustment.redundancy == 102 - 58
    assert float(adjustment.sigma0) == pytest.approx(float(expected.sigma0), rel=1e-9)
    assert 0.3 / 0.5 * 0.7 < float(adjustment.sigma0) < 0.3 / 0.5 * 1.5  # rays and fiducials with errors of 0.3 px
    for found, other in (
        (adjustment.block.interior.elements, expected.block.interior.elements),
        (adjustment.block.exterior.projection_centre, expected.block.exterior.projection_centre),
        (adjustment.block.object_points, expected.block.object_points),
        (adjustment.standard_deviations.object_points, expected.standard_deviations.object_points),
        (adjustment.residuals[0] / PIXEL, expected.residuals[0] / PIXEL),
    ):
        np.testing.assert_allclose(found, other, rtol=1e-7, atol=1e-7)
    normalised = np.asarray(adjustment.residuals[0]) / PIXEL / 0.5  # px over the sigma in px
    np.testing.assert_allclose(adjustment.weighted_residuals[0], normalised, rtol=1e-12)
    assert_report_tells(adjustment, write_report(adjustment, tmp_path / "results"))


def assert_report_tells(adjustment, results: Path) -> None:
    fits = adjustment.block.structure.inner_orientations
    table = pl.read_csv(results / "inner_orientation.csv", schema_overrides={"image": pl.String, "worst": pl.String})
    assert table["image"].to_list() == list(IMAGES) and table["c1"].null_count() == 4
    np.testing.assert_array_equal(table["a1"], [fit.parameters["a1"] for fit in fits])
    np.testing.assert_array_equal(table["sigma0"], [fit.sigma0 for fit in fits])
    residuals = pl.read_csv(results / "fiducials.csv")["vx", "vy"].to_numpy()
    np.testing.assert_array_equal(residuals, np.concatenate([fit.residuals for fit in fits]))
    written = json.loads((results / "report.json").read_text())
    assert {"inner_orientation.csv", "fiducials.csv"} <= set(written["files"])
    entry = report_dict(adjustment)["inner_orientations"]["021"]
    assert entry == written["inner_orientations"]["021"]
    assert entry["fiducials"]["3"] == fits[2].residuals[2].tolist() and entry["redundancy"] == 10
    lines = report_text(adjustment).splitlines()
    start = lines.index("Inner orientation: fits to the fiducials, mm")
    assert lines[start + 2].split() == "image transformation fiducials redundancy sigma0 worst vx vy".split()
    vx, vy = fits[0].residuals[fits[0].worst]
    worst = fits[0].fiducials[fits[0].worst]
    row = ["011", "affine", "8", "10", f"{fits[0].sigma0:.5f}", worst, f"{vx:.5f}", f"{vy:.5f}"]
    assert lines[start + 3].split() == row


def test_film_is_written_in_mm(film: Path, tmp_path: Path) -> None:
    block = read_block_folder(film)
    write_block_folder(block, tmp_path / "again")
    again = read_block_folder(tmp_path / "again")
    np.testing.assert_array_equal(again.rays.coordinates, block.rays.coordinates)
    np.testing.assert_array_equal(again.rays.sigmas, block.rays.sigmas)
    np.testing.assert_array_equal(again.interior.elements, block.interior.elements)
    assert again.structure.cameras == block.structure.cameras and again.structure.inner_orientations == ()


def test_grid_base_from_the_format(tmp_path: Path) -> None:
    folder = film_folder(tmp_path / "small")
    change(folder, "block.toml", 19, "none", "ebner")
    block = read_block_folder(folder)
    given = dict(zip(block.structure.model.elements, block.interior.elements[0].tolist(), strict=True))
    assert given["grid_base"] == pytest.approx(0.4 * 46.0) and given["e12"] == 0.0
    write_block_folder(block, tmp_path / "again")
    np.testing.assert_array_equal(read_block_folder(tmp_path / "again").interior.elements, block.interior.elements)
