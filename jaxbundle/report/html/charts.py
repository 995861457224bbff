"""Charts in SVG, each with one pair of axes."""

import numpy as np
from scipy.special import ndtr

from jaxbundle.report.html.axes import Axes, log_limits
from jaxbundle.report.html.markup import tag, text, titled
from jaxbundle.report.html.raster import signed
from jaxbundle.report.pictures.camera_pictures import Correlations, Distortion
from jaxbundle.report.pictures.known import known, limits
from jaxbundle.report.pictures.point_pictures import MAX_RAYS, RayCounts
from jaxbundle.report.pictures.ray_pictures import Histogram
from jaxbundle.report.section import short
from jaxbundle.solve.history import History

NAMED = 8  # maximum number of images whose names stand below their marks
NOTABLE = 0.9  # correlations above this are printed in bold


def histogram_chart(histogram: Histogram, name: str, log: bool = False) -> str:
    """Histograms of x and y as steps, with the normal distribution of the same number of values."""
    edges, counts = histogram
    width, total = edges[1] - edges[0], counts.sum(1).max(initial=0)
    fine = np.linspace(edges[0], edges[-1], 181)
    normal = total * width * np.exp(-0.5 * fine**2) / np.sqrt(2 * np.pi)
    top = float(max(counts.max(initial=1), normal.max(initial=1.0)))
    axes = Axes((edges[0], edges[-1]), (0.5, 2 * top) if log else (0.0, 1.08 * top), log_y=log)
    parts = [axes.frame("w / sigma0", "number")]
    for k, row in enumerate(counts):
        x, y = np.repeat(edges, 2)[1:-1], np.repeat(np.maximum(row, 0.5) if log else row, 2)
        parts.append(axes.line(x, y, f"line series{k}"))
    parts.append(axes.line(fine, np.where(normal < 0.5, np.nan, normal) if log else normal, "line expected"))
    base = axes.height - axes.bottom
    for low, high, *row in zip(edges[:-1].tolist(), edges[1:].tolist(), *counts.tolist(), strict=True):
        expected = total * float(ndtr(high) - ndtr(low))
        numbers = ", ".join(f"{axis} {count}" for axis, count in zip("xyz", row, strict=False))
        words = f"{low:.1f} to {high:.1f}: {numbers}, expected {expected:.1f}"
        left, right = float(axes.u(low)), float(axes.u(high))
        parts.append(
            tag("rect", titled(words), x=left, y=axes.top, width=right - left, height=base - axes.top, class_="hit")
        )
    return axes.picture("".join(parts), name)


def quantile_chart(quantiles: np.ndarray, name: str) -> str:
    """Quantiles of the residuals over those of the normal distribution: equal quantiles lie on the line."""
    bounds = limits(np.append(quantiles.ravel(), [-3, 3]))
    axes = Axes(bounds, bounds, height=386)  # width equal to height inside the margins
    line = axes.line(np.array(bounds), np.array(bounds), "line expected")
    marks = [
        tag("circle", titled(f"normal {a:.2f}, residual {b:.2f}"), cx=float(axes.u(a)), cy=float(axes.v(b)), r=2.4)
        for a, b in quantiles.tolist()
    ]
    inside = axes.frame("normal quantile", "residual quantile") + line + tag("g", marks, class_="dots")
    return axes.picture(inside, name)


def bar_chart(numbers: np.ndarray, labels: list[str], axis: tuple[str, str], name: str) -> str:
    """A chart with one bar for each label."""
    top = float(max(known(numbers).max(initial=0.0, where=np.isfinite(known(numbers))), 1e-12))
    axes = Axes((-0.6, len(numbers) - 0.4), (0.0, 1.08 * top), bottom=44)
    base, half = axes.height - axes.bottom, 0.36 * axes.scale
    bars = [
        tag(
            "rect",
            titled(f"{label}: {number:g}"),
            x=float(axes.u(k)) - half,
            y=float(axes.v(number)),
            width=2 * half,
            height=base - float(axes.v(number)),
        )
        for k, (number, label) in enumerate(zip(known(numbers).tolist(), labels, strict=True))
        if np.isfinite(number) and number > 0
    ]
    return axes.picture(axes.frame(*axis, labels) + tag("g", bars, class_="bars"), name)


def counts_chart(counts: RayCounts, name: str) -> str:
    """Number of points by number of rays."""
    shown = np.arange(len(counts.rays)) < max(np.flatnonzero(counts.points).max(initial=0) + 1, 4)
    labels = [f"{k}" if k < MAX_RAYS else f"{k}+" for k in counts.rays[shown].tolist()]
    return bar_chart(counts.points[shown].astype(float), labels, ("rays of a point", "points"), name)


def strip_chart(values: np.ndarray, names: tuple[str, ...], limit: float, name: str) -> str:
    """A chart with one mark for each image in order, on an absolute scale; marks above the limit are highlighted."""
    values = known(values)
    top = float(max(1.15 * np.nanmax(np.append(values, 0.0)), 1.25 * limit))
    axes = Axes((-0.5, len(values) - 0.5), (0.0, top), width=900, height=260)
    marks = []
    radius = 3.4 if len(values) <= 200 else 2.0
    for k, value in enumerate(values.tolist()):
        if np.isfinite(value):
            words = f"{names[k]}: {value:.3g}"
            kind = "beyond" if value > limit else None
            place = {"cx": float(axes.u(k)), "cy": float(axes.v(value))}
            marks.append(tag("circle", titled(words), **place, r=radius, class_=kind))
    line = axes.line(np.array(axes.x), np.array([1.0, 1.0]), "line expected")
    few = tuple(map(short, names)) if len(names) <= NAMED else ()
    frame = axes.frame("image" if few else "image, in order", "rms w / sigma0", few)
    return axes.picture(frame + line + tag("g", marks, class_="dots"), name)


def distortion_chart(curve: Distortion, name: str) -> str:
    """A chart of the radial distortion with a band of one standard deviation on each side."""
    low, high = curve.distortion - curve.sd, curve.distortion + curve.sd
    both = np.concatenate([curve.distortion, low, high, [0.0]])
    axes = Axes((0.0, float(curve.radius[-1]) or 1.0), limits(both, 0.08), left=64)
    parts = [axes.frame(f"radius [{curve.unit}]", f"radial distortion [{curve.unit}]")]
    if np.isfinite(known(low)).all() and np.isfinite(known(high)).all():
        u = np.concatenate([axes.u(curve.radius), axes.u(curve.radius[::-1])]).tolist()
        v = np.concatenate([axes.v(low), axes.v(high[::-1])]).tolist()
        parts.append(
            tag("polygon", points=" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(u, v, strict=True)), class_="band")
        )
    parts.append(axes.line(curve.radius, curve.distortion, "line series0"))
    return axes.picture("".join(parts), name)


def correlation_chart(found: Correlations, name: str) -> str:
    """A chart of the matrix of correlations with numbers: blue below zero, orange above."""
    count = len(found.elements)
    cell, left = (44.0 if count <= 8 else 34.0), 124.0
    parts = []
    for i, one in enumerate(found.elements):
        parts.append(tag("text", text(one), x=left - 8, y=26 + cell * (i + 0.6), class_="tick end"))
        parts.append(tag("text", text(one[:9]), x=left + cell * (i + 0.5), y=16.0, class_="tick middle"))
        for k, other in enumerate(found.elements[: i + 1]):
            r = float(np.nan_to_num(found.matrix[i, k]))
            place = {"x": left + cell * k, "y": 24 + cell * i}
            words = titled(f"{one}, {other}: {r:.4f}")
            parts.append(tag("rect", words, **place, width=cell - 2, height=cell - 2, fill=signed(r)))
            shade = "on-dark" if abs(r) > 0.6 else "on-light"
            centre = {"x": place["x"] + cell / 2 - 1, "y": place["y"] + cell / 2 + 3}
            weight = " strong" if abs(r) > NOTABLE and i != k else ""
            parts.append(tag("text", f"{r:.2f}", **centre, class_=f"cell middle {shade}{weight}"))
    size = left + cell * count + 6, 30 + cell * count
    return tag("svg", parts, viewBox=f"0 0 {size[0]:g} {size[1]:g}", role="img", aria_label=name, class_="matrix")


def history_charts(history: History) -> list[tuple[str, str]]:
    """Charts of v^T P v, damping and step over the iterations, on logarithmic scales; rejected steps are crosses."""
    rows = np.flatnonzero(~np.isnan(np.asarray(history.damping)))
    accepted = np.asarray(history.accepted)[rows]
    named = (
        ("vTPv after the step", 2 * np.asarray(history.cost)[rows]),
        ("damping lambda", np.asarray(history.damping)[rows]),
        ("step |J d| / |v|", np.asarray(history.step)[rows]),
    )
    charts = []
    for name, values in named:
        values = known(values)
        axes = Axes((0.0, len(rows) + 1.0), log_limits(values), height=250, top=14, log_y=True)
        positive = np.where(values > 0, values, np.nan)
        marks = []
        for row, value, good in zip(rows.tolist(), positive.tolist(), accepted.tolist(), strict=True):
            if np.isfinite(value):
                u, v = float(axes.u(row + 1.0)), float(axes.v(value))
                words = titled(f"iteration {row + 1}: {value:.8g}{'' if good else ', rejected'}")
                cross = f"M{u - 3:.1f} {v - 3:.1f}l6 6m0 -6l-6 6"
                marks.append(
                    tag("circle", words, cx=u, cy=v, r=3.0) if good else tag("path", words, d=cross, class_="cross")
                )
        inside = axes.frame("iteration", "") + axes.line(rows + 1.0, positive, "line series0")
        charts.append((name, axes.picture(inside + tag("g", marks, class_="dots"), name)))
    return charts
