"""Content of the chapters of the page: pictures, then the sections of the chapter."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from jaxbundle.report.figures import Figures
from jaxbundle.report.html import charts, drawings, verdict_tiles
from jaxbundle.report.html.html_tables import Rows, section_html
from jaxbundle.report.html.markup import figure, tag, text
from jaxbundle.report.html.packed_scene import scene
from jaxbundle.report.html.verdict_tiles import chance
from jaxbundle.report.pictures import camera_pictures, network, point_pictures, ray_pictures, vector_pictures
from jaxbundle.report.pictures.known import root_mean_square
from jaxbundle.report.pictures.plan_picture import CONTROL_POINT, Plan, plan
from jaxbundle.report.section import Chapter, ReportColumn, Section, digits, fixed

CAMERAS = 20  # maximum number of cameras with pictures; the tables contain all
HIGH_RMS = 1.5  # images with a larger rms of w / sigma0 are marked
ROUNDING = 1e-9  # share of the rms; a smaller mean is the rounding of numbers whose sum is zero
FEW_CHECK_POINTS = 30  # minimum number for a statement of accuracy (ASPRS 2023)


def chapters_of(figures: Figures, sections: Iterable[Section]) -> dict[Chapter, str]:
    """The markup of all chapters in order; a chapter without content is left out."""
    rows: Rows = {}
    seen, of_images = plan(figures), ray_pictures.image_figures(figures)
    extra = _extra(figures, of_images)
    by_chapter: dict[Chapter, list[str]] = {chapter: [] for chapter in Chapter}
    for section in sections:
        if section.chapter is Chapter.VERDICT and section.title == "Verdict":
            continue  # its content is in the tiles and the findings
        by_chapter[section.chapter].append(section_html(section, extra, rows))
    makers: Mapping[Chapter, Callable[[], str]] = {
        Chapter.VERDICT: lambda: verdict_tiles.tiles(figures) + verdict_tiles.findings_html(figures, rows),
        Chapter.PLAN: lambda: _plan(figures, seen),
        Chapter.CONTROL: lambda: _control(figures, seen),
        Chapter.RESIDUALS: lambda: _residuals(figures),
        Chapter.IMAGES: lambda: _images(figures, of_images),
        Chapter.CAMERAS: lambda: _cameras(figures),
        Chapter.POINTS: lambda: _points(figures, seen),
        Chapter.CONNECTIONS: lambda: _connections(figures, seen),
        Chapter.RELIABILITY: lambda: _reliability(figures),
        Chapter.ITERATIONS: lambda: _iterations(figures),
    }
    found = {}
    for chapter, body in by_chapter.items():
        pictures = makers[chapter]() if chapter in makers else ""
        if pictures or any(body):
            found[chapter] = pictures + "".join(body)
    return found


def _extra(figures: Figures, found: ray_pictures.ImageFigures) -> dict[str, tuple[ReportColumn, ...]]:
    """Additional columns of the page: residuals of each image, and t of check points."""
    names = ("rms vx", "rms vy")
    columns = [ReportColumn("", v, name, lambda x: digits(x, 3)) for name, v in zip(names, found.rms.T, strict=False)]
    columns += [
        ReportColumn("", found.standardised, "rms w/sigma0", lambda x: fixed(x, 2)),
        ReportColumn("", found.largest, "largest", lambda x: fixed(x, 2)),
        ReportColumn("", 100 * found.coverage, "covered [%]", lambda x: fixed(x, 0)),
    ]
    check = vector_pictures.check_vectors(figures)
    t = [ReportColumn("", v, f"t {c}", lambda x: fixed(x, 2)) for c, v in zip("XYZ", check.ratio.T, strict=True)]
    return {"images": tuple(columns), "check_points": tuple(t)}


def _plan(figures: Figures, seen: Plan) -> str:
    structure = figures.structure
    drawn, said = drawings.block_drawing(seen, structure.image_names, structure.point_names, structure.object_unit)
    data, words = scene(figures, seen)
    legend = "Crosses are projection centres, triangles control points, squares check points, dots tie points; each"
    legend += " outline is the area of the points measured on one image."
    buttons = "".join(
        tag("button", text(label), type="button", data_do=action, title=title)
        for action, label, title in (
            ("in", "+", "zoom in"),
            ("out", "\u2212", "zoom out"),
            ("tilt", "3D", "tilt the view; drag to rotate"),
            ("outlines", "Outlines", "outlines of the images"),
            ("ties", "Tie points", "show the tie points"),
            ("sd", "Precision", "colour the tie points by their standard deviation"),
            ("reset", "Reset", "the whole block from above"),
        )
    )
    canvas = tag("canvas", "", tabindex="0", role="img", aria_label="plan of the block, zoom and drag")
    moving = tag("div", buttons, class_="tools") + canvas + tag("p", "", class_="hover", aria_live="polite")
    script = tag("script", data, type="application/json", id="scene")
    moved = tag("div", moving + tag("p", text(f"{words}; click on a mark to see its row."), class_="more"))
    still = tag("div", figure(drawn, f"{legend} In this block {said}."), class_="still")
    return still + tag("div", moved, class_="plan scripted", id="plan") + script


def _control(figures: Figures, seen: Plan) -> str:
    control, check = vector_pictures.control_vectors(figures), vector_pictures.check_vectors(figures)
    groups = {name: found for name, found in (("control", control), ("check", check)) if found.names}
    if not groups:
        return tag("p", "There are no observed control points and no check points.")
    west, south, east, north = drawings.bounds_of(seen)
    factor = vector_pictures.arrow_factor(list(groups.values()), float(np.hypot(east - west, north - south)))
    unit = figures.structure.object_unit
    drawn = drawings.vector_drawing(seen, groups, factor, unit)
    caption = (
        f"Adjusted - given coordinates: arrows in X and Y, bars in Z, all enlarged {factor:g} times. Blue triangles:"
        " control points (internal, used); orange squares: check points (external, not used)."
    )
    slider = tag("input", type="range", min="-2", max="2", step="0.1", value="0", aria_label="length of the arrows")
    slider = tag("label", f"Length of arrows {slider}" + tag("output", "x 1"), class_="scripted factor")
    return slider + figure(drawn, caption, "wide") + _statistics(groups, unit)


def _statistics(groups: dict[str, vector_pictures.Vectors], unit: str) -> str:
    """Statistics of the differences, separate for control and check points, and the test of the check points."""
    heads = ("", "number", "rms", "expected rms", "mean", "largest")
    lines = []
    for name, group in groups.items():
        found = vector_pictures.spread(group)
        kind = "internal" if name == "control" else "external"
        for k, c in enumerate("XYZ"):
            if found.number[k]:
                mean = found.mean[k] if abs(found.mean[k]) > ROUNDING * found.rms[k] else 0.0
                numbers = (found.rms[k], found.expected[k], mean, found.largest[k])
                cells = [str(found.number[k]), *(digits(x, 3) for x in numbers)]
                first = tag("th", f"{name} points {c} [{text(unit)}], {kind}", scope="row")
                lines.append(tag("tr", first + "".join(tag("td", cell) for cell in cells), class_=kind))
    head = tag("thead", tag("tr", [tag("th", h, scope="col") for h in heads]))
    table = tag("div", tag("table", head + tag("tbody", lines)), class_="table")
    return table + "".join(tag("p", text(words)) for words in _accuracy(groups, unit))


def _accuracy(groups: dict[str, vector_pictures.Vectors], unit: str) -> list[str]:
    if "check" not in groups:
        return ["There are no check points: the external accuracy of the block is unknown."]
    check = groups["check"]
    total, count, probability = vector_pictures.external_test(check)
    words = []
    if count:
        verdict = "agree" if probability > 0.05 else "do not agree"
        words.append(
            f"Check points and predicted standard deviations {verdict}: sum of t\u00b2 {total:.3g}"
            f" of {count} differences, {chance(probability)} (chi-square, upper tail; limit 0.05)."
        )
    d = check.difference
    ce = vector_pictures.CE90 * root_mean_square(np.hypot(d[:, 0], d[:, 1]))
    le = vector_pictures.LE90 * root_mean_square(d[:, 2])
    points = len(check.names)
    few = f"; {FEW_CHECK_POINTS} points or more are required for such a statement" if points < FEW_CHECK_POINTS else ""
    words.append(f"CE90 {digits(ce, 3)}, LE90 {digits(le, 3)} {unit} from {points} check points{few}.")
    return words


def _residuals(figures: Figures) -> str:
    if not len(figures.structure.ray_image):
        return ""
    histogram, quantiles = ray_pictures.residual_histogram(figures), ray_pictures.normal_quantiles(figures)
    is_w = figures.reliability is not None
    what = "w / sigma0" if is_w else "v / (sigma0 sigma), which is smaller than w / sigma0"
    parts = [
        figure(
            charts.histogram_chart(histogram, "histogram of the residuals"),
            f"{what} of all rays, x blue, y orange; dashed: the normal distribution.",
        ),
        figure(
            charts.histogram_chart(histogram, "histogram of the residuals, logarithmic", log=True),
            "The same on a logarithmic scale: values far outside are gross errors.",
        ),
        figure(
            charts.quantile_chart(quantiles, "quantiles of the residuals"),
            "Quantiles of the residuals over quantiles of the normal distribution; dashed: equal quantiles.",
        ),
    ]
    return tag("div", parts, class_="figures")


def _images(figures: Figures, found: ray_pictures.ImageFigures) -> str:
    names = figures.structure.image_names
    if not len(names):
        return ""
    chosen = drawings.thinned(len(names))
    chart = charts.strip_chart(
        found.standardised[chosen], tuple(names[k] for k in chosen), HIGH_RMS, "residuals of the images"
    )
    high = int((np.nan_to_num(found.standardised) > HIGH_RMS).sum())
    caption = f"Root mean square of w / sigma0 of each image (expected: 1); {high} of {len(names)} exceed {HIGH_RMS}."
    if len(chosen) < len(names):
        caption += f" {len(chosen)} images are drawn."
    return figure(chart, caption, "wide")


def _cameras(figures: Figures) -> str:
    parts = []
    count = len(figures.structure.cameras)
    for c in range(min(count, CAMERAS)):
        parts.append(_camera(figures, c))
    if count > CAMERAS:
        parts.append(
            tag("p", f"Pictures of {CAMERAS} of {count} cameras are drawn; cameras.csv has all.", class_="more")
        )
    return "".join(parts)


def _camera(figures: Figures, c: int) -> str:
    name = figures.structure.cameras[c].name
    parts, field = [], ray_pictures.residual_field(figures, c)
    if len(field.rays):
        drawn, factor = drawings.field_drawing(field, f"mean residuals of camera {name}")
        p = chance(field.probability)
        caption = f"Mean residuals in {len(field.rays)} cells of the format, enlarged {factor:g} times; blue: more than"
        caption += f" 3 of their standard deviations. Hypothesis of zero means: {p}, correlations neglected."
        parts.append(figure(drawn, caption))
    curve = camera_pictures.distortion(figures, c)
    if curve is not None:
        chart = charts.distortion_chart(curve, f"radial distortion of camera {name}")
        parts.append(figure(chart, "Radial distortion over the radius, with a band of one standard deviation."))
    found = camera_pictures.correlations(figures, c)
    if found is not None:
        chart = charts.correlation_chart(found, f"correlations of camera {name}")
        parts.append(figure(chart, "Correlations of the estimated elements."))
    return tag("h3", text(f"Camera {name}")) + tag("div", parts, class_="figures") if parts else ""


def _points(figures: Figures, seen: Plan) -> str:
    parts, unit = [], figures.structure.object_unit
    if (np.nan_to_num(figures.points_sd) > 0).any():
        for component in ("Z", "X"):
            found = point_pictures.precision_map(figures, component)
            name = f"standard deviations of {component}"
            drawn = drawings.precision_drawing(found, seen, unit, name)
            control = "; triangles: control" if (seen.role == CONTROL_POINT).any() else ""
            parts.append(figure(drawn, f"Median standard deviation of {component} over the block{control}."))
    counts = point_pictures.ray_counts(figures)
    if counts.points.sum():
        parts.append(figure(charts.counts_chart(counts, "rays of the points"), "Points by their number of rays."))
    return tag("div", parts, class_="figures")


def _connections(figures: Figures, seen: Plan) -> str:
    found, names = network.connections(figures), figures.structure.image_names
    if not len(found.pairs):
        return ""
    drawn = drawings.connection_drawing(seen, found, names, figures.structure.object_unit)
    weak = int((found.common < network.WEAK).sum())
    caption = (
        f"The {network.STRONGEST} strongest connections of each image: {len(found.pairs)} of {found.of_all} pairs with"
        f" common points are drawn; thicker lines have more of them, dashed ones fewer than {network.WEAK} ({weak})."
    )
    return figure(drawn, caption, "wide")


def _reliability(figures: Figures) -> str:
    if figures.reliability is None:
        return ""
    edges = np.linspace(0.0, 1.0, 21)
    r = np.clip(np.nan_to_num(figures.reliability.redundancy_numbers[0]).ravel(), 0.0, 1.0)
    counts, labels = (
        np.histogram(r, edges)[0],
        [f"{edge:.1f}" if k % 2 == 0 else "" for k, edge in enumerate(edges[:-1])],
    )
    chart = charts.bar_chart(counts.astype(float), labels, ("redundancy number", "number"), "redundancy numbers")
    caption = "Redundancy numbers of the image coordinates: the part of an error that appears in its residual."
    return tag("div", figure(chart, caption), class_="figures")


def _iterations(figures: Figures) -> str:
    history = figures.adjustment.iterations.history
    if not len(np.flatnonzero(~np.isnan(np.asarray(history.damping)))):
        return tag("p", "This solver does not report its iterations.")
    drawn = [figure(picture, name) for name, picture in charts.history_charts(history)]
    return tag("div", drawn, class_="figures")
