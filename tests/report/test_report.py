"""The report against the adjustment it tells of."""

import dataclasses
import json
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.report import files, report_dict, report_text, write_report
from jaxbundle.report.data import finite, json_text
from jaxbundle.report.figures import figures_of
from jaxbundle.report.section import ReportTable, decimals, first, short
from jaxbundle.report.sections import sections_of
from jaxbundle.report.text import WIDTH, aligned
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status


@pytest.fixture(scope="module")
def adjustment():
    return adjust(small_block().block)


@pytest.fixture(scope="module")
def report(adjustment):
    return report_dict(adjustment)


def with_structure(adjustment, **changes):
    structure = dataclasses.replace(adjustment.block.structure, **changes)
    return dataclasses.replace(adjustment, block=dataclasses.replace(adjustment.block, structure=structure))


# The dictionary


def test_counts_and_sigma0(adjustment, report):
    assert report["observations"] - report["unknowns"] == report["redundancy"] == adjustment.redundancy
    assert report["sigma0"] == float(adjustment.sigma0)
    assert report["vtPv"] == pytest.approx(report["sigma0"] ** 2 * report["redundancy"], rel=1e-12)
    assert (report["status"], report["trustworthy"], report["stopping_rule"]) == ("converged", True, "angle")
    assert report["iterations"] == int(adjustment.iterations.trials)
    assert report["datum"] == "control points and observed stations"


def test_images_in_the_unit_of_the_block(adjustment):
    sd = adjustment.standard_deviations
    for unit, factor in (("deg", 180 / math.pi), ("gon", 200 / math.pi), ("rad", 1.0)):
        image = report_dict(with_structure(adjustment, angle_unit=unit))["images"]["2_03"]
        assert list(image) == ["X0", "Y0", "Z0", "omega", "phi", "kappa"]
        assert image["Y0"] == [adjustment.block.exterior.projection_centre[6, 1], sd.projection_centre[6, 1]]
        assert image["kappa"] == pytest.approx(
            [float(angle[6, 2]) * factor for angle in (adjustment.block.exterior.angles, sd.angles)], rel=1e-14
        )


def test_points_hold_the_unknown_ones_and_0_for_what_is_held(adjustment, report):
    structure = adjustment.block.structure
    assert len(report["points"]) == structure.point_free.any(1).sum()
    control, tie = report["points"]["1"], report["points"]["20"]
    assert control["Z"][1] == 0.0 and control["X"][1] > 0
    assert tie["Z"] == [adjustment.block.object_points[19, 2], adjustment.standard_deviations.object_points[19, 2]]
    free = structure.point_free.copy()
    free[19] = False
    assert "20" not in report_dict(with_structure(adjustment, point_free=free))["points"]


def test_cameras_hold_the_estimated_elements(adjustment, report):
    camera = report["cameras"]["camera"]
    assert list(camera) == ["principal_distance", "x0", "y0", "K1", "K2"]
    assert camera["K1"] == [adjustment.block.interior.elements[0, 3], adjustment.standard_deviations.interior[0, 3]]
    held = np.zeros_like(adjustment.block.structure.interior_free)
    assert report_dict(with_structure(adjustment, interior_free=held))["cameras"] == {}


def test_check_points(adjustment, report):
    point = adjustment.block.structure.check_point[1]
    entry = report["check_points"][adjustment.block.structure.point_names[point]]
    assert list(entry) == ["X", "Y", "Z", "dX", "dY", "dZ"]
    assert entry["X"][0] - entry["dX"] == pytest.approx(
        float(adjustment.block.check_points.coordinates[1, 0]), abs=1e-9
    )
    assert abs(entry["dZ"]) < 5 * entry["Z"][1]


def test_correlations_of_the_estimated_elements(adjustment, report):
    pairs = report["correlations"]["camera"]
    assert len(pairs) == 10
    assert pairs["K1,K2"] == adjustment.interior_correlations[0, 3, 4]


def test_what_is_not_finite_is_null(adjustment):
    without = report_dict(dataclasses.replace(adjustment, cofactors=None))
    assert without["points"]["20"]["X"][1] is None and without["points"]["1"]["Z"][1] == 0.0
    assert without["correlations"] == {}
    unknown = eqx.tree_at(
        lambda a: a.block.check_points.coordinates,
        adjustment,
        adjustment.block.check_points.coordinates.at[0, 2].set(jnp.nan),
    )
    entry = next(iter(report_dict(unknown)["check_points"].values()))
    assert entry["dZ"] is None and entry["dX"] is not None


def test_is_ready_for_json(report):
    assert json.loads(json_text(report)) == json.loads(json.dumps(report, allow_nan=False))


def test_json_holds_what_json_can_hold():
    odd = {
        "nan": math.nan,
        "numbers": [1, 2.5, math.inf, np.float64(-math.inf), np.int32(3), np.bool_(True), None],
        3: np.array([[1.0, np.nan]]),
        "images": {"a": {"X": (1.0, math.nan)}},
        "status": Status.CONVERGED,
    }
    assert json.loads(json_text(finite(odd)), parse_constant=pytest.fail) == {
        "nan": None,
        "numbers": [1, 2.5, None, None, 3, True, None],
        "3": [[1.0, None]],
        "images": {"a": {"X": [1.0, None]}},
        "status": 1,
    }


@pytest.mark.parametrize(
    ("value", "status"), [(math.nan, Status.STALLED), (math.inf, Status.SINGULAR), (1e300, Status.DIVERGED)]
)
def test_a_report_is_written_whatever_the_numbers(adjustment, tmp_path, value, status):
    def spoilt(leaf):
        return leaf * 0 + value if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating) else leaf

    ended = dataclasses.replace(adjustment, iterations=adjustment.iterations._replace(status=jnp.asarray(int(status))))
    folder = write_report(jax.tree.map(spoilt, ended), tmp_path / "results")
    report = json.loads((folder / "report.json").read_text(), parse_constant=pytest.fail)
    assert report["status"] == status.name.lower().replace("_", " ")


def test_size_of_a_report_is_estimated(adjustment, tmp_path):
    size = sum(path.stat().st_size for path in write_report(adjustment, tmp_path / "results").iterdir())
    assert size < files.report_size(adjustment.block) < 3 * size + 50_000


# The sections


def test_sections_are_made_once_for_all_forms(adjustment, report):
    """Columns of a table are equally long, every name stands once, and text and data are the same numbers."""
    sections = [section() for section in sections_of(figures_of(adjustment, ()))]
    tables = {part.name: part for section in sections for part in section.parts if isinstance(part, ReportTable)}
    for table in tables.values():
        (rows,) = {len(column.values) for column in table.columns}
        assert len(table.page) == 0 or table.page.max() < rows
        names = [column.name for column in table.columns if column.in_file]
        assert len(set(names)) == len(names)
    written = {f"{table.name}.csv" for table in tables.values() if table.in_file}
    assert written == {name for name in files.result_files(adjustment.block) if name.endswith(".csv")}
    (z,) = [column for column in tables["points"].columns if column.name == "Z"]
    assert report["points"]["20"]["Z"][0] == z.values[19]
    assert f" {z.show(z.values[19])} " in report_text(adjustment)


# The text


def test_text_opens_with_findings_and_fits_the_page(adjustment):
    text = report_text(adjustment)
    assert text.isascii() and max(map(len, text.splitlines())) <= WIDTH
    titles = [a for a, b in zip(text.splitlines(), text.splitlines()[1:], strict=False) if b and set(b) == {"-"}]
    assert titles[:4] == [
        "Verdict",
        "Adjustment",
        "Observations",
        "Images: adjusted values and standard deviations",
    ]
    assert titles[4:] == [
        "Cameras: estimated elements",
        "Object points",
        "Control points: adjusted - observed [m]",
        "Stations: computed - observed",
        "Check points: adjusted - known",
        "Rays with the largest |w|/sigma0",
        *titles[10:],
    ]
    unknown = adjustment.block.structure.point_free.any(1).sum()
    assert f"the first 50 of {unknown} points; the tables contain all" in text
    assert f"{float(adjustment.sigma0):.6g} a posteriori" in text


def test_text_of_long_names_and_no_precision(adjustment):
    names = tuple(f"a very long name of an image {k}" for k in range(8))
    text = report_text(with_structure(dataclasses.replace(adjustment, cofactors=None), image_names=names, name="\xfc"))
    assert max(map(len, text.splitlines())) <= WIDTH and "a very l...image 7" in text
    assert text.startswith("Adjustment of block ?")


def test_columns():
    assert aligned([("a", "10"), ("bcd", "2")]) == ["  a    10", "  bcd   2"]
    assert [decimals(np.array(sd)) for sd in ([0.012, 0.0], [3.4], [np.nan], [1e-15])] == [3, 1, 4, 9]
    assert short("x" * 18) == "x" * 18 and len(short("x" * 19)) == 18
    assert first(np.arange(3), 1, "points")[1] == "... the first 1 of 3 points; the tables contain all"


# The folder


def test_folder_of_results(adjustment, tmp_path):
    folder = write_report(adjustment, tmp_path / "new" / "results")
    assert sorted(path.name for path in folder.iterdir()) == sorted(files.result_files(adjustment.block))
    assert [path.name for path in folder.parent.iterdir()] == ["results"]
    rays = pl.read_csv(folder / "rays.csv")
    assert np.allclose(rays.select("vx", "vy").to_numpy(), adjustment.residuals[0])
    images = pl.read_csv(folder / "images.csv")
    assert np.allclose(images["sX0"], adjustment.standard_deviations.projection_centre[:, 0])
    control = pl.read_csv(folder / "control.csv")
    assert control["vX"].null_count() == 0 and control["vZ"].null_count() == len(control)
    r, w = adjustment.redundancy_numbers[1][:, 0], adjustment.weighted_residuals[1][:, 0]
    np.testing.assert_allclose(control["rX"], r, rtol=1e-12)
    np.testing.assert_allclose(control["wX"], w / np.sqrt(r), rtol=1e-9)
    assert control["rZ"].null_count() == len(control)
    report = json.loads((folder / "report.json").read_text())
    assert report.pop("files") == files.result_files(adjustment.block)
    assert report.pop("date").endswith("UTC")
    assert report == json.loads(json.dumps(report_dict(adjustment)))


def test_earlier_results_are_replaced_and_other_files_kept(adjustment, tmp_path):
    write_report(adjustment, tmp_path)
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "report.txt").write_text("report of an earlier")
    fewer = with_structure(adjustment, check_point=np.zeros(0, np.int32))
    none = jnp.zeros((0, 3))
    fewer = eqx.tree_at(lambda a: a.block.check_points, fewer, type(fewer.block.check_points)(none, none))
    write_report(fewer, tmp_path)
    assert not (tmp_path / "check_points.csv").exists()
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert "report of an earlier" not in (tmp_path / "report.txt").read_text()
    words = " ".join((tmp_path / "report.txt").read_text().split())
    assert f"sigma0 {float(fewer.sigma0):.6g} a posteriori" in words
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("name", ["images.csv", "report.txt"])
def test_files_of_others_are_not_overwritten(adjustment, tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(FileExistsError, match=f"contains {name}, which no adjustment wrote"):
        write_report(adjustment, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name] and (tmp_path / name).read_text() == "mine"


def test_a_file_is_no_folder(adjustment, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileExistsError, match="is a file"):
        write_report(adjustment, tmp_path / "file")


def test_never_a_half_written_result(adjustment, tmp_path, monkeypatch):
    earlier = write_report(adjustment, tmp_path / "earlier")
    before = {path.name: path.read_bytes() for path in earlier.iterdir()}

    def interrupted(figures, sections):
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "text_of", interrupted)
    for folder in (earlier, tmp_path / "new"):
        with pytest.raises(KeyboardInterrupt):
            write_report(adjustment, folder)
    assert [path.name for path in tmp_path.iterdir()] == ["earlier"]
    assert {path.name: path.read_bytes() for path in earlier.iterdir()} == before
