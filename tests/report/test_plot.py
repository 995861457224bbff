"""Plots, point clouds, notebooks, comparisons, and the commands that show them."""

import copy
import dataclasses
import json
import sys
import types
from typing import Any

import matplotlib
import numpy as np
import pytest
from cases.simulated_blocks import small_block
from matplotlib import pyplot
from scipy.stats import chi2

import jaxbundle as jb
from jaxbundle.block.problems import BlockError
from jaxbundle.cli import main, showing
from jaxbundle.io.formats.ply_files import ply_vertices
from jaxbundle.report.comparison import compare_reports, congruency
from jaxbundle.report.comparison_report import comparison_html, comparison_text
from jaxbundle.report.data import dict_of
from jaxbundle.report.figures import figures_of
from jaxbundle.report.files import write_report
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.batch import Batch, Outcome

matplotlib.use("Agg")  # no window


@pytest.fixture(scope="module")
def result():
    return adjust(small_block().block)


@pytest.fixture(scope="module")
def report(result):
    figures = figures_of(result, ())
    return dict_of(figures, [section() for section in sections_of(figures)])


@pytest.fixture
def ax():
    figure, axes = pyplot.subplots()
    yield axes
    pyplot.close(figure)


# Each plot, and a number read back from what it drew


def of_line(ax, k):
    return np.asarray(ax.lines[k].get_xydata())


def test_block(result, ax):
    assert jb.plot.block(result, ax=ax) is ax
    control = next(line for line in ax.lines if line.get_label() == "control")
    assert len(control.get_xdata()) == 9
    assert len(ax.collections[0].get_paths()) == 8


@pytest.mark.parametrize("kind", ["control", "check"])
def test_differences(result, report, ax, kind):
    getattr(jb.plot, kind)(result, factor=100.0, ax=ax)
    arrows = ax.collections[0]
    if kind == "check":
        expected = [[entry["dX"], entry["dY"]] for entry in report["check_points"].values()]
    else:
        expected = np.asarray(result.residuals[1])[:, :2]
    np.testing.assert_allclose(np.stack([arrows.U, arrows.V], 1), expected)
    assert arrows.scale == pytest.approx(0.01)


def test_residual_histogram(result, ax):
    jb.plot.residual_histogram(result, log=True, ax=ax)
    assert ax.patches[0].get_data().values.sum() == len(result.block.structure.ray_image)


def test_residual_field_and_residuals_of_an_image(result, ax):
    jb.plot.residual_field(result, "camera", ax=ax)
    assert len(ax.collections[0].U) > 9 and ax.yaxis_inverted()
    ax.clear()
    jb.plot.image_residuals(result, "2_03", ax=ax)
    mine = result.block.structure.ray_image == 6
    np.testing.assert_allclose(ax.collections[0].U, np.asarray(result.residuals[0])[mine, 0])
    with pytest.raises(ValueError, match="there is no image 'x'; there are 1_01"):
        jb.plot.image_residuals(result, "x", ax=ax)


def test_images(result, ax):
    jb.plot.images(result, "rays", ax=ax)
    counts = np.bincount(result.block.structure.ray_image)
    assert of_line(ax, 0)[:, 1].tolist() == counts.tolist()
    with pytest.raises(ValueError, match="is not one of rms, largest, rays, coverage"):
        jb.plot.images(result, "colour", ax=ax)


def test_correlations_and_distortion(result, report, ax):
    jb.plot.correlations(result, ax=ax)
    drawn = np.asarray(ax.images[0].get_array())
    assert drawn[3, 4] == report["correlations"]["camera"]["K1,K2"]
    ax.clear()
    jb.plot.distortion(result, ax=ax)
    r, dr = of_line(ax, 0)[-1]
    k1, k2 = (report["cameras"]["camera"][name][0] for name in ("K1", "K2"))
    assert dr == pytest.approx(k1 * r**3 + k2 * r**5)


def test_band_of_the_distortion_is_that_of_the_cofactors(result, ax):
    """Of K1 r^3 + K2 r^5, by the law of propagation of variances."""
    jb.plot.distortion(result, ax=ax)
    (r, dr), band = of_line(ax, 0)[-1], ax.collections[0].get_paths()[0].vertices
    row, q = np.array([r**3, r**5]), np.asarray(result.cofactors.interior)[0, 3:5, 3:5]
    upper = band[np.isclose(band[:, 0], r), 1].max()
    assert upper - dr == pytest.approx(float(result.sigma0) * np.sqrt(row @ q @ row), rel=1e-6)


def test_precision_map_and_ellipses(result, ax):
    jb.plot.precision_map(result, "X", ax=ax)
    sd = np.asarray(result.standard_deviations.object_points)[:, 0]
    assert sd[sd > 0].min() <= np.nanmin(ax.images[0].get_array()) <= sd.max()
    with pytest.raises(ValueError, match="component 'W'"):
        jb.plot.precision_map(result, "W", ax=ax)
    ax.clear()
    jb.plot.ellipses(result, factor=10.0, ax=ax)
    widths = 2 * np.asarray(ax.collections[0]._widths) / 10.0 / 2
    np.testing.assert_allclose(
        widths**2 + (2 * np.asarray(ax.collections[0]._heights) / 10.0 / 2) ** 2,
        (np.asarray(result.standard_deviations.projection_centre)[:, :2] ** 2).sum(1),
    )
    with pytest.raises(ValueError, match="without standard deviations"):
        jb.plot.ellipses(dataclasses.replace(result, cofactors=None), ax=ax)


def test_redundancy_connections_and_doming(result, ax):
    jb.plot.redundancy(result, ax=ax)
    assert ax.patches[0].get_data().values.sum() == result.redundancy_numbers[0].size
    ax.clear()
    jb.plot.connections(result, least=20, ax=ax)
    assert 0 < len(ax.collections[0].get_segments()) < 28
    ax.clear()
    jb.plot.doming(result, ax=ax)
    assert sorted(of_line(ax, 0)[:, 1]) == pytest.approx(sorted(np.asarray(result.check_differences)[:, 2]))


def test_iterations_and_comparison(result, report, ax):
    jb.plot.iterations(result, ax=ax)
    assert of_line(ax, 0)[1, 1] == report["history"]["2"]["vtPv"]
    ax.clear()
    jb.plot.compare(result, result, ax=ax)
    assert ax.patches[0].get_data().values.sum() == len(report["points"])


def test_new_axes_and_wrong_arguments(result, unchecked_types):
    ax = jb.plot.iterations(result)
    assert ax.get_xlabel() == "iteration"
    pyplot.close("all")
    wrong: Any = "result"
    with pytest.raises(TypeError, match="plot.images takes"):
        jb.plot.images(wrong)


# Other forms


def test_point_cloud(result, tmp_path):
    content = jb.report.to_ply(result, tmp_path / "points.ply", stations=tmp_path / "stations.ply").read_bytes()
    header = content.partition(b"end_header\n")[0]
    offset = np.array(header.split(b"offset to be added: ")[1].split(b"\n")[0].split(), float)
    rows = ply_vertices(tmp_path / "points.ply", content, ("sZ", "class", "largest_w"))
    xyz = np.stack([rows[axis] for axis in "xyz"], 1) + offset
    np.testing.assert_allclose(xyz, result.block.object_points, atol=1e-9)
    np.testing.assert_allclose(rows["sZ"], np.asarray(result.standard_deviations.object_points)[:, 2], rtol=1e-6)
    assert np.bincount(rows["class"]).tolist() == [88, 9, 3]
    structure, w = result.block.structure, np.abs(jb.statistics.reliability(result).w[0]).max(1) / float(result.sigma0)
    assert rows["largest_w"][20] == pytest.approx(w[structure.ray_point == 20].max())
    jb.export(result, tmp_path / "again.ply")
    assert (tmp_path / "again.ply").read_bytes() == content
    lines = (tmp_path / "stations.ply").read_text().splitlines()
    first = np.array([line.split() for line in lines[lines.index("end_header") + 1 :][:5]], float) + offset
    np.testing.assert_allclose(first[0], result.block.exterior.projection_centre[0], atol=1e-5)
    assert (first[1:, 2] < first[0, 2]).all()  # the camera looks down
    seen = result.block.structure.ray_point[result.block.structure.ray_image == 0]
    points = np.asarray(result.block.object_points)[seen]
    ground = (
        first[0]
        + (first[1:] - first[0]) * ((points[:, 2].mean() - first[0, 2]) / (first[1:, 2] - first[0, 2]))[:, None]
    )
    assert (ground.min(0)[:2] < points.min(0)[:2]).all() and (points.max(0)[:2] < ground.max(0)[:2]).all()


def test_notebook(result):
    shown = result._repr_html_()
    assert f"{float(result.sigma0):.6g}" in shown and "<script" not in shown and len(shown) < 20_000
    structure = dataclasses.replace(result.block.structure, name="<b>")
    odd = dataclasses.replace(result, block=dataclasses.replace(result.block, structure=structure))
    assert "&lt;b&gt;" in odd._repr_html_()


def test_blocks_and_batches_in_a_notebook(result):
    shown = result.block._repr_html_()
    assert "8 images" not in shown and "<td align='left'>8</td>" in shown and len(shown) < 20_000
    structure = dataclasses.replace(result.block.structure, name="<b>")
    assert "Block &lt;b&gt;" in dataclasses.replace(result.block, structure=structure)._repr_html_()
    batch = Batch((Outcome("<i>", result, 1.5), Outcome("bad", ValueError("no rays"), 0.1)))
    shown = batch._repr_html_()
    assert "&lt;i&gt;" in shown and "no rays" in shown and shown.count("<tr>") == 3 and "Batch of 2 blocks" in shown


class Recorded(types.ModuleType):
    """Stands for the package rerun: it keeps what is logged."""

    def __init__(self):
        super().__init__("rerun")
        self.logged, self.saved, self.rows = {}, [], []

    def RecordingStream(self, name):
        self.name = name
        return self

    def save(self, path):
        self.saved.append(path)

    def log(self, entity, *what, static=False):
        self.logged.setdefault(entity if isinstance(entity, str) else "/".join(entity), []).append(what)

    def set_time(self, timeline, sequence):
        self.rows.append((timeline, sequence))

    def flush(self):
        pass

    disconnect = flush

    def __getattr__(self, kind):
        if kind.startswith("_"):
            raise AttributeError(kind)
        return lambda *values, **named: (kind, values, named)


def test_rerun(result, monkeypatch, tmp_path):
    """A point on the axis of the recorded pinhole is where the image has its principal point."""
    rerun = Recorded()
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    assert jb.report.to_rerun(result, tmp_path / "block.rrd") == tmp_path / "block.rrd" and rerun.saved
    structure, block = result.block.structure, result.block
    assert len(rerun.logged["points/tie"][0][0][1][0]) == 88 and len(rerun.logged["points/check"][0][0][1][0]) == 3
    ((_, _, pose), (_, _, lens)) = rerun.logged[f"images/{structure.image_names[2]}"][0]
    rays = structure.ray_image == 2
    xyz = np.asarray(block.object_points)[structure.ray_point[rays]] - np.asarray(block.exterior.projection_centre[2])
    u = xyz @ pose["mat3x3"]
    assert (u[:, 2] > 0).all()
    projected = u[:, :2] / u[:, 2:] * lens["focal_length"] + lens["principal_point"]
    assert (
        np.abs(projected - block.rays.coordinates[rays]).max() < 80
    )  # px: 0.43 mm of distortion in the corner, which a pinhole has not
    (name,) = [name for name in rerun.logged if name.startswith(f"images/{structure.image_names[2]}/residuals x ")]
    arrows = rerun.logged[name][0][0][2]
    v = np.asarray(result.residuals[0])[rays] * float(name.split(" x ")[1])
    np.testing.assert_allclose(arrows["vectors"], v * [1, -1], atol=1e-9)
    assert rerun.rows == [("iteration", k + 1) for k in range(int(result.iterations.trials))]
    assert len(rerun.logged["iterations/vTPv"]) == len(rerun.rows)


def test_rerun_is_missing(result, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(BlockError, match=r"to_rerun needs the package rerun-sdk, .*'jaxbundle\[rerun\]'"):
        jb.report.to_rerun(result, tmp_path / "block.rrd")
    assert not (tmp_path / "block.rrd").exists()


# Comparisons


def test_two_results_of_one_block(report):
    other = copy.deepcopy(report)
    other["points"]["20"]["Z"][0] += 0.5
    other["cameras"]["camera"]["K1"][0] *= 2
    other |= {"datum": "another", "findings": [{"severity": "check", "what": "something"}]}
    del other["images"]["1_01"]
    found = compare_reports(report, other)
    points = found.differences[0]
    row = points.names.index("20")
    sd = report["points"]["20"]["Z"][1]
    assert points.ratio[row, 2] == pytest.approx(0.5 / (np.sqrt(2) * sd))
    assert found.findings == ((), ("check: something",))
    assert {t.table: t.only for t in found.differences}["images"] == (1, 0)
    words = comparison_text(found)
    assert "control points and observed stations  ->  another" in words and "camera K1" in words
    assert "7 in both, 1 only in A" in words and words.isascii()
    assert "<h1>2 x 4 images and 2 x 4 images</h1>" in comparison_html(found)


def test_results_that_have_nothing_in_common(report):
    with pytest.raises(ValueError, match="different units"):
        compare_reports(report, {**report, "units": {"object": "ft", "angle": "deg"}})
    with pytest.raises(ValueError, match="no point, image or camera with the same name"):
        compare_reports(report, {"units": report["units"]})


def surveys(rng, moved=0.0):
    """Two surveys of forty points with their standard deviations; the first point has moved."""
    truth, sd = rng.normal(0, 100, (40, 3)), np.array([0.01, 0.01, 0.02])
    data = []
    for shift in (0.0, moved):
        xyz = truth + rng.normal(0, 1, (40, 3)) * sd
        xyz[0, 2] += shift
        points = {f"P{k}": {c: [x, s] for c, x, s in zip("XYZ", row, sd, strict=True)} for k, row in enumerate(xyz)}
        data.append({"units": {"object": "m", "angle": "deg"}, "points": points})
    return data


def test_congruency_keeps_its_level_and_finds_what_moved():
    rng = np.random.default_rng(8)
    tests = [congruency(compare_reports(*surveys(rng)), 0.05) for _ in range(400)]
    assert tests[0].freedom == 120 and tests[0].limit == pytest.approx(chi2.isf(0.05, 120))
    for share in (np.mean([t.statistic > t.limit for t in tests]), np.mean([t.moved.any() for t in tests])):
        assert 0.02 < share < 0.09  # 4 standard deviations around 0.05
    found = [congruency(compare_reports(*surveys(rng, 0.2))) for _ in range(20)]
    assert all(test.moved[0] and not test.congruent for test in found)
    assert sum(test.moved[1:].sum() for test in found) < 5
    with pytest.raises(ValueError, match="level 2 is not"):
        congruency(compare_reports(*surveys(rng)), 2)


# The command line


@pytest.fixture
def run(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["jaxbundle", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


def test_compare_and_show(result, run, tmp_path, monkeypatch):
    folder = write_report(result, tmp_path / "a", ())
    code, out, err = run("compare", folder, folder, "--surveys", "-o", tmp_path / "c.html")
    assert (code, err) == (0, "") and "the points are congruent" in out
    assert (tmp_path / "c.html").read_text().startswith("<!doctype html>")
    assert json.loads((folder / "report.json").read_text())["history"]["1"]["accepted"] is True
    for other, words in ((tmp_path, "contains no report.json"), (tmp_path / "bad", "is damaged")):
        other.mkdir(exist_ok=True)
        if other.name == "bad":
            (other / "report.json").write_text("{")
        code, _, err = run("compare", folder, other)
        assert code == 2 and words in err
    opened = []
    monkeypatch.setattr(showing, "has_screen", lambda: True)
    monkeypatch.setattr(showing.webbrowser, "open", lambda address: opened.append(address) or True)
    assert run("show", folder) == (0, f"Report: {folder / 'report.html'}\n", "")
    assert opened == [(folder / "report.html").as_uri()]
    monkeypatch.setattr(showing, "has_screen", lambda: False)
    assert "open it in a browser" in run("show", folder)[1]
    assert run("show", folder, "--text")[1] == (folder / "report.txt").read_text()
    assert run("show", tmp_path)[0] == 2
