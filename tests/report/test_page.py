"""The report as a page: chapters, numbers, names, policy and size; and in a browser, where there is one."""

import base64
import dataclasses
import hashlib
import json
import re
import shutil
import zlib
from html.parser import HTMLParser

import jax.numpy as jnp
import numpy as np
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.report import report_html, write_html
from jaxbundle.report.data import dict_of
from jaxbundle.report.figures import figures_of
from jaxbundle.report.html.axes import Axes, log_limits, plan_axes
from jaxbundle.report.html.packed_scene import _grid, _packed
from jaxbundle.report.html.page import html_of
from jaxbundle.report.html.raster import VIRIDIS, png, viridis
from jaxbundle.report.made import Made, input_files, made_now, made_section
from jaxbundle.report.pictures import network, point_pictures, ray_pictures, vector_pictures
from jaxbundle.report.pictures.known import nice
from jaxbundle.report.pictures.plan_picture import plan
from jaxbundle.report.section import Chapter
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjust import adjust

NAUGHTY = "<b>&\"'</b><script>alert(1)</script>"


class Reader(HTMLParser):
    """Headings, texts, addresses and titles of a page; that every element is closed."""

    def __init__(self, page: str):
        super().__init__()
        self.open, self.headings, self.words, self.ids, self.links, self.titles = [], [], [], set(), [], []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if "id" in given:
            assert given["id"] not in self.ids, given["id"]
            self.ids.add(given["id"])
        if tag == "a":
            self.links.append(given["href"])
        self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)
            if self.open[-1] == "h2":
                self.headings.append(data)
            if self.open[-1] == "title":
                self.titles.append(data)


@pytest.fixture(scope="module")
def adjustment():
    return adjust(small_block().block)


@pytest.fixture(scope="module")
def figures(adjustment):
    culprit = Finding(Kind.SUSPECT, "point 5 is looked at", "look", (Subject("control", ("5",), "X"),))
    return figures_of(adjustment, (culprit,))


@pytest.fixture(scope="module")
def page(figures):
    made = Made("0", "2026-01-01 00:00 UTC", "jaxbundle adjust", (("rays.csv", "ab" * 32),))
    return html_of(figures, [*(section() for section in sections_of(figures)), made_section(figures, made)])


def test_chapters_stand_in_their_order(page):
    reader = Reader(page)
    assert reader.headings == [chapter.value for chapter in Chapter]
    assert all(link[1:] in reader.ids for link in reader.links)  # findings and contents lead somewhere
    assert "#control-4" in reader.links
    words = " ".join(reader.words)
    assert "2026-01-01 00:00 UTC" in words and "rays.csv abababababababab" in words and "internal" in words


def test_numbers_are_those_of_report_json(figures, page):
    reader = Reader(page)
    report, titles = dict_of(figures, [section() for section in sections_of(figures)]), reader.titles
    assert f"{report['sigma0']:.6g}" in reader.words
    for name, entry in report["check_points"].items():
        (title,) = [words for words in titles if words.startswith(f"check {name}:")]
        drawn = dict(re.findall(r"d([XYZ]) (\S+)", title))
        assert {c: float(d) for c, d in drawn.items()} == pytest.approx(
            {c: entry[f"d{c}"] for c in "XYZ"}, rel=1e-5, abs=1e-12
        )
    for pair, r in report["correlations"]["camera"].items():
        first, second = pair.split(",")
        assert f"{second}, {first}: {r:.4f}" in titles
    for number, entry in report["history"].items():
        assert f"iteration {number}: {entry['vtPv']:.8g}" in titles


def test_names_are_escaped(adjustment, figures):
    structure = figures.structure
    names = (NAUGHTY, *structure.image_names[1:])
    points = (NAUGHTY, *structure.point_names[1:])
    odd = dataclasses.replace(structure, name=NAUGHTY, image_names=names, point_names=points)
    changed = dataclasses.replace(adjustment, block=dataclasses.replace(adjustment.block, structure=odd))
    page = report_html(changed, found=())
    assert "<b>&" not in page and page.count("<script") == 2 and NAUGHTY in " ".join(Reader(page).words)
    scene = json.loads(page.split('id="scene">')[1].split("</script>")[0])
    assert scene["stations"][0][3] == NAUGHTY


def test_nothing_is_loaded_and_only_our_script_runs(page):
    assert "http" not in page.replace("http-equiv", "")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy.startswith("default-src &#x27;none&#x27;") and "unsafe" not in policy
    for kind in ("script", "style"):
        (own,) = re.findall(f"<{kind}>(.*?)</{kind}>", page, re.DOTALL)
        assert base64.b64encode(hashlib.sha256(own.encode()).digest()).decode() in policy
    assert not re.search(r'\sstyle="| on[a-z]+="', page)  # the policy would not let them


def test_the_same_twice_and_on_disk(adjustment, tmp_path):
    assert report_html(adjustment, found=()) == report_html(adjustment, found=())
    path = write_html(adjustment, tmp_path / "page.html", found=())
    assert Reader(path.read_text(encoding="utf-8")).headings[0] == "Verdict" and path.stat().st_size < 400_000


def test_without_precision(adjustment):
    bare = dataclasses.replace(adjustment, cofactors=None, redundancy_numbers=None)
    headings = Reader(report_html(bare, found=())).headings
    assert "Reliability" not in headings and "Object points" in headings


# The numbers of the pictures


def test_plan_has_the_roles_and_the_outlines(figures):
    seen = plan(figures)
    assert (seen.role == 1).sum() == 9 and (seen.role == 2).sum() == 3
    structure = figures.structure
    for k, outline in enumerate(seen.outlines):
        xy = seen.points[structure.ray_point[structure.ray_image == k], :2]
        assert 3 <= len(outline) <= 12 and {tuple(corner) for corner in outline} <= {tuple(point) for point in xy}
        np.testing.assert_array_equal(outline.max(0), xy.max(0))


def test_vectors_and_the_test_from_outside(adjustment, figures):
    check = vector_pictures.check_vectors(figures)
    np.testing.assert_allclose(check.difference, adjustment.check_differences)
    np.testing.assert_allclose(np.abs(check.difference) / check.expected, np.abs(check.ratio))
    total, count, probability = vector_pictures.external_test(check)
    assert count == 9 and total == pytest.approx(float((check.ratio**2).sum())) and 0.001 < probability < 1
    found = vector_pictures.spread(check)
    assert found.rms[2] == pytest.approx(float(np.sqrt(np.mean(np.square(adjustment.check_differences[:, 2])))))
    control = vector_pictures.control_vectors(figures)
    np.testing.assert_allclose(control.difference[:, :2], adjustment.residuals[1][:, :2])
    factor = vector_pictures.arrow_factor([control, check], 1000.0)
    longest = max(np.nanmax(np.abs(v.difference)) for v in (control, check))
    assert 1000 / 8 / 2.5 < factor * longest <= 1000 / 8


def test_residuals_by_class_image_and_cell(adjustment, figures):
    count = len(figures.structure.ray_image)
    histogram = ray_pictures.residual_histogram(figures)
    assert histogram.counts.sum(1).tolist() == [count, count]
    w = ray_pictures.standardised(figures)
    inside = (w[:, 0] >= 0) & (w[:, 0] < histogram.edges[31])
    assert histogram.counts[0, 30] == inside.sum()
    of_images = ray_pictures.image_figures(figures)
    v = np.asarray(adjustment.residuals[0])[figures.structure.ray_image == 3]
    np.testing.assert_allclose(of_images.rms[3], np.sqrt((v**2).mean(0)))
    field = ray_pictures.residual_field(figures, 0)
    assert field.rays.sum() == count
    np.testing.assert_allclose((field.mean * field.rays[:, None]).sum(0), figures.residuals[0].sum(0), atol=1e-9)
    assert field.probability > 0.001


def test_a_planted_distortion_shows_in_the_field(figures):
    """Residuals that point outwards give a mean field that does, and one that is not zero."""
    xy = np.asarray(figures.adjustment.block.rays.coordinates)
    left, low, right, high = ray_pictures.image_format(figures, 0)
    outwards = (xy - [(left + right) / 2, (low + high) / 2]) * [1.0, -1.0] / 3000  # y of residuals points up
    planted = dataclasses.replace(
        figures,
        residuals=(outwards, *figures.residuals[1:]),
        reliability=None,
        normalised=(4 * outwards, *figures.normalised[1:]),
    )
    field = ray_pictures.residual_field(planted, 0)
    across, up = field.x - (left + right) / 2, (low + high) / 2 - field.y
    assert (field.mean[:, 0] * across + field.mean[:, 1] * up > 0).all() and field.probability < 1e-6


def test_many_points_are_packed_in_few_bytes():
    """A quarter of a million points of a flat block; what is unpacked differs by less than the step of the grid."""
    rng = np.random.default_rng(0)
    xyz = rng.uniform([0, 0, 90], [9000, 5000, 300], (20_000, 3))
    grid, (low, size) = _grid(xyz)
    assert size.tolist() == [size[0]] * 3
    np.testing.assert_allclose(grid / 65535 * size + low, xyz, atol=0.51 * size[0] / 65535)
    order = np.lexsort((grid[:, 0], grid[:, 1] // 256))
    packed = _packed(grid[order], np.stack([low, size]), np.exp(rng.normal(-4, 1, xyz.shape)))
    raw = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"]), -15), np.uint8).reshape(7, -1).astype(int)
    assert len(packed["data"]) < 7 * 20_000
    np.testing.assert_array_equal(np.cumsum(raw[0] + 256 * raw[1]) % 65536, grid[order, 0])
    np.testing.assert_array_equal(raw[2:6:2] + 256 * raw[3:6:2], grid[order, 1:].T)
    assert raw[6].min() == 1 and raw[6].max() <= 255


def test_maps_and_connections(figures):
    found = point_pictures.precision_map(figures, "Z")
    sd = figures.points_sd[:, 2]
    assert np.nanmin(found.median) >= sd[sd > 0].min() and np.nanmax(found.median) <= sd.max()
    assert point_pictures._medians(np.array([0, 0, 2, 0]), np.array([3.0, 1.0, 5.0, 2.0]), 3)[[0, 2]].tolist() == [
        2.0,
        5.0,
    ]
    counts = point_pictures.ray_counts(figures)
    assert counts.points.sum() == (figures.rays_of_point > 0).sum()
    structure, linked = figures.structure, network.connections(figures)
    for (a, b), number in zip(linked.pairs, linked.common, strict=True):
        seen = [set(structure.ray_point[structure.ray_image == k]) for k in (a, b)]
        assert len(seen[0] & seen[1]) == number > 0


def test_scales_and_colours():
    axes = Axes((0.0, 10.0), (1.0, 1000.0), log_y=True)
    assert axes.v(1000.0) == axes.top and axes.u(10.0) == axes.width - axes.right
    assert axes.v(10.0) - axes.v(100.0) == pytest.approx(axes.v(1.0) - axes.v(10.0))
    assert log_limits(np.array([0.0, np.nan, 3.0, 250.0])) == (1.0, 1000.0)
    level = plan_axes((0.0, 0.0, 100.0, 30.0))
    assert level.u(100.0) - level.u(0.0) == pytest.approx(100 / 30 * (level.v(0.0) - level.v(30.0)))
    assert [nice(x) for x in (7.0, 0.2, 1.0, 49.9)] == [5.0, 0.2, 1.0, 20.0]
    np.testing.assert_array_equal(viridis(np.array([0.0, 1.0])), VIRIDIS[[0, -1]])
    assert base64.b64decode(png(np.zeros((2, 3, 4), np.uint8)).split(",")[1]).startswith(b"\x89PNG")


def test_inputs_are_told_with_their_hashes(tmp_path):
    (tmp_path / "rays.csv").write_bytes(b"image,point\n")
    (tmp_path / "notes.md").touch()
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "points.csv").touch()
    (tmp_path / "other.csv").mkdir()
    made = made_now("jaxbundle adjust x", input_files(tmp_path))
    assert made.inputs == (("rays.csv", hashlib.sha256(b"image,point\n").hexdigest()),)
    (tmp_path / "block.toml").write_text('[tables]\npoints = "below/points.csv"\nrays = "rays.csv"\n')
    assert [path.name for path in input_files(tmp_path / "block.toml")] == ["points.csv", "block.toml", "rays.csv"]
    assert made.date.endswith(" UTC") and input_files(tmp_path / "rays.csv") == [tmp_path / "rays.csv"]


# In a browser


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def browser():
    """Chromium of the system without a screen; without one the test is skipped. The build installs it where it can."""
    if CHROMIUM is None:
        pytest.skip("there is no Chromium to show the page in")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser: install it")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def opened(browser, page, tmp_path):
    """Opens the page; at the end nothing was said in the console, and nothing was asked for but the page."""
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    said, asked, contexts = [], [], []

    def open_page(**options):
        context = browser.new_context(**options)
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: said.append(message.text))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto((tmp_path / "report.html").as_uri())
        return tab

    yield open_page
    for context in contexts:
        context.close()
    assert not said and {url.rsplit("/", 1)[1] for url in asked} == {"report.html"}


def test_tables_sort_and_search(opened):
    tab = opened(viewport={"width": 1280, "height": 900})
    table = tab.locator("table[data-table=control]")
    table.locator("thead button", has_text="|w|/sigma0").click()
    sizes = [float(words) for words in table.locator("tbody tr td:last-child").all_text_contents()]
    assert sizes == sorted(sizes, reverse=True) and len(sizes) == 9
    search = tab.locator("input.search[aria-label='search in points']")
    search.fill("55")
    shown = tab.locator("table[data-table=points] tbody tr:visible").all_text_contents()
    assert 0 < len(shown) < 20 and all("55" in words for words in shown)
    assert tab.evaluate("document.documentElement.scrollWidth") == 1280


def test_the_plan_is_drawn_and_leads_to_rows(opened, figures):
    tab = opened(viewport={"width": 1280, "height": 900})
    tab.wait_for_function("document.documentElement.plan && document.documentElement.plan.places")
    colours = (
        "(c) => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size"
    )
    data, grid = tab.evaluate("[scene.textContent, [...document.documentElement.plan.ties.grid]]")
    ties = json.loads(data)["ties"]
    unpacked = np.reshape(grid, (3, -1)).T / 65535 * ties["size"] + ties["low"]
    seen = plan(figures)
    of_rows = seen.points[json.loads(data)["rows"]]
    assert len(of_rows) == (seen.role == 0).sum()
    np.testing.assert_allclose(unpacked, of_rows, atol=max(ties["size"]) / 65535)
    canvas = tab.locator("canvas")
    assert canvas.evaluate(colours) > 20
    canvas.scroll_into_view_if_needed()
    u, v = tab.evaluate("document.documentElement.plan.places.find((p) => p[3] === 'control-4').slice(0, 2)")
    canvas.hover(position={"x": u, "y": v})
    assert "control point 5:" in tab.locator(".hover").text_content()
    canvas.click(position={"x": u, "y": v})
    assert tab.locator("tr.marked").get_attribute("id") == "control-4"
    tab.locator("button[data-do=tilt]").click()
    tab.locator("button[data-do=sd]").click()
    tab.locator("#theme").click()
    assert tab.locator("html").get_attribute("data-theme") == "dark"


def test_narrow_printed_and_without_scripts(opened, tmp_path):
    narrow = opened(viewport={"width": 390, "height": 800}, color_scheme="dark")
    assert narrow.evaluate("document.documentElement.scrollWidth") == 390
    assert len(narrow.pdf(path=tmp_path / "report.pdf")) > 50_000
    plain = opened(java_script_enabled=False)
    assert plain.locator("h2").all_text_contents() == [chapter.value for chapter in Chapter]
    assert plain.locator(".still svg").is_visible() and not plain.locator("canvas").is_visible()


def test_history_is_that_of_the_progress(adjustment):
    told = []
    again = adjust(small_block().block, progress=told.append)
    history = again.iterations.history
    assert [p.cost for p in told] == np.asarray(history.cost)[: len(told)].tolist()
    assert [p.accepted for p in told] == np.asarray(history.accepted)[: len(told)].tolist()
    assert [p.ended for p in told] == [False] * (len(told) - 1) + [True]
    assert jnp.isnan(history.damping[len(told) :]).all() and len(history.cost) == 200
