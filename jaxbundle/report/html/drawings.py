"""Plans in SVG: the block in plan view, arrows at control and check points, connections, the map of precision."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxbundle.report.html.axes import Axes, arrow, plan_axes, scale_bar
from jaxbundle.report.html.markup import tag, text, titled
from jaxbundle.report.html.raster import hexadecimal, png, viridis
from jaxbundle.report.pictures.known import limits, nice
from jaxbundle.report.pictures.network import WEAK, Connections
from jaxbundle.report.pictures.plan_picture import CHECK_POINT, CONTROL_POINT, TIE, Plan
from jaxbundle.report.pictures.point_pictures import PrecisionMap
from jaxbundle.report.pictures.ray_pictures import Field
from jaxbundle.report.pictures.vector_pictures import Vectors

MAX_MARKS = 1500  # maximum number of objects of one type in a static picture; the script draws all
MAX_LABELS = 80  # maximum number of names beside points
LETTERS, LETTER, LINE = 12, 6.6, 12.0  # maximum length of a name, width of a letter, height of a line in the picture
MAX_TITLED = 2000  # maximum number of lines that show their names; more lines are drawn as one path


def bounds_of(plan: Plan) -> tuple[float, float, float, float]:
    """Limits of the coordinates of stations, outlines and points."""
    xy = np.concatenate([plan.stations[:, :2], plan.points[:, :2]])
    (west, east), (south, north) = limits(xy[:, 0]), limits(xy[:, 1])
    return west, south, east, north


def thinned(count: int, most: int = MAX_MARKS) -> np.ndarray:
    """Evenly spread indices, up to a maximum number."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)


def _there(xy: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.isfinite(xy[:, :2]).all(1))


def triangle(u: float, v: float, size: float) -> str:
    """Path of a triangle around a point of the picture."""
    return f"M{u:.1f} {v - size:.1f}l{size:.1f} {1.75 * size:.1f}h{-2 * size:.1f}z"


def square(u: float, v: float, size: float) -> str:
    """Path of a square around a point of the picture."""
    return f"M{u - size:.1f} {v - size:.1f}h{2 * size:.1f}v{2 * size:.1f}h{-2 * size:.1f}z"


def block_drawing(plan: Plan, names: tuple[str, ...], points: tuple[str, ...], unit: str) -> tuple[str, str]:
    """The plan of the block, and a sentence about the drawn part."""
    axes = plan_axes(bounds_of(plan))
    tie = _there(plan.points)
    tie = tie[plan.role[tie] == TIE]
    shown, images = tie[thinned(len(tie))], thinned(len(names))
    parts = [tag("g", _dots(axes, plan.points[shown]), class_="tie")]
    outlines = [_polygon(axes, plan.outlines[k]) for k in images.tolist() if len(plan.outlines[k]) > 2]
    parts.append(tag("path", d="".join(outlines), class_="outline"))
    for role, shape, kind in ((CONTROL_POINT, triangle, "control"), (CHECK_POINT, square, "check")):
        marked = _there(plan.points)
        marked = marked[plan.role[marked] == role]
        parts.append(tag("g", _marks(axes, plan.points[marked], [points[p] for p in marked], shape), class_=kind))
    there = images[np.isfinite(plan.stations[images, :2]).all(1)]
    crosses = [
        tag("path", titled(f"image {names[k]}"), d=f"M{u - 4:.1f} {v:.1f}h8M{u:.1f} {v - 4:.1f}v8")
        for k, u, v in _places(axes, plan.stations, there)
    ]
    parts.append(tag("g", crosses, class_="station"))
    said = f"{len(shown)} of {len(tie)} tie points and {len(images)} of {len(names)} images are drawn here"
    return axes.picture("".join(parts) + scale_bar(axes, unit), "plan of the block"), said


def _places(axes: Axes, xy: np.ndarray, rows: np.ndarray) -> list[tuple[int, float, float]]:
    u, v = axes.u(xy[rows, 0]), axes.v(xy[rows, 1])
    return list(zip(rows.tolist(), u.tolist(), v.tolist(), strict=True))


def _dots(axes: Axes, xy: np.ndarray) -> str:
    """Small dots, one path for all of them."""
    u, v = axes.u(xy[:, 0]), axes.v(xy[:, 1])
    steps = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(u.tolist(), v.tolist(), strict=True))
    return tag("path", d=steps)


def _polygon(axes: Axes, corners: np.ndarray) -> str:
    u, v = axes.u(corners[:, 0]).tolist(), axes.v(corners[:, 1]).tolist()
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(u, v, strict=True)) + "z"


def uncrowded(axes: Axes, xy: np.ndarray, names: Sequence[str]) -> set[int]:
    """Points whose names can stand beside them without lying upon that of one before them."""
    boxes, free = np.zeros((0, 4)), set[int]()
    for k, (u, v) in enumerate(zip(axes.u(xy[:, 0]).tolist(), axes.v(xy[:, 1]).tolist(), strict=True)):
        width = LETTER * len(names[k][:LETTERS])
        inside = (boxes[:, 0] < u + width) & (boxes[:, 2] > u) & (boxes[:, 1] < v + LINE) & (boxes[:, 3] > v)
        if not inside.any():
            boxes = np.append(boxes, [[u, v, u + width, v + LINE]], 0)
            free.add(k)
        if len(free) == MAX_LABELS:
            break
    return free


def _marks(axes: Axes, xy: np.ndarray, names: list[str], shape: Callable[[float, float, float], str]) -> list[str]:
    parts, free = [], uncrowded(axes, xy, names)
    for k, u, v in _places(axes, xy, np.arange(len(xy))):
        parts.append(tag("path", titled(names[k]), d=shape(u, v, 5.0)))
        if k in free:
            parts.append(tag("text", text(names[k][:LETTERS]), x=u + 8, y=v + 4, class_="tick halo"))
    return parts


def vector_drawing(plan: Plan, groups: dict[str, Vectors], factor: float, unit: str) -> str:
    """Differences in plan as arrows, in height as bars, all on the same scale."""
    axes = plan_axes(bounds_of(plan))
    outlines = [_polygon(axes, plan.outlines[k]) for k in thinned(len(plan.outlines), 300) if len(plan.outlines[k]) > 2]
    parts = [tag("path", d="".join(outlines), class_="outline faint")]
    labelled = _labelled(axes, groups)
    for kind, vectors in groups.items():
        shape = triangle if kind == "control" else square
        for k in _there(vectors.position).tolist():
            parts.append(_vector(axes, vectors, k, Look(kind, shape, (kind, k) in labelled, factor, unit)))
    length = nice(0.18 * (axes.x[1] - axes.x[0]) / factor)
    size, right = length * factor * axes.scale, axes.width - axes.right - 40
    reference = tag("path", d=f"M{right - size:.1f} {axes.height - 16}{arrow(size, 0.0)}", class_="axis arrow")
    words = f"{length:g} {unit} (x {factor:g})"
    reference += tag("text", words, x=right - size - 8, y=axes.height - 12, class_="tick end")
    return axes.picture(
        "".join(parts) + scale_bar(axes, unit) + reference, "differences at control and check points", class_="vectors"
    )


def _labelled(axes: Axes, groups: dict[str, Vectors]) -> set[tuple[str, int]]:
    """Kind and row of the points whose names are drawn, those of large differences first."""
    rows = [(kind, k) for kind, vectors in groups.items() for k in _there(vectors.position).tolist()]
    size = np.array([np.nan_to_num(np.abs(groups[kind].difference[k])).max() for kind, k in rows])
    rows = [rows[n] for n in np.argsort(-size, kind="stable")]
    at = np.array([groups[kind].position[k, :2] for kind, k in rows]).reshape(-1, 2)
    free = uncrowded(axes, at, [groups[kind].names[k] for kind, k in rows])
    return {rows[n] for n in free}


class Look(NamedTuple):
    """Style of points with differences: kind, shape, whether with names, factor and unit of differences."""

    kind: str
    shape: Callable[[float, float, float], str]
    labelled: bool
    factor: float
    unit: str


def _vector(axes: Axes, vectors: Vectors, k: int, look: Look) -> str:
    """Markup of one point: its mark, the arrow of its difference in X and Y, the bar of the difference in Z."""
    kind, shape, labelled, factor, unit = look
    u, v = float(axes.u(vectors.position[k, 0])), float(axes.v(vectors.position[k, 1]))
    d = vectors.difference[k]
    known = np.nan_to_num(d) * factor * axes.scale
    numbers = " ".join(f"d{c} {x:.6g} {unit}" for c, x in zip("XYZ", d.tolist(), strict=True) if np.isfinite(x))
    words = titled(f"{kind} {vectors.names[k]}: {numbers}")
    planar = tag("path", d=f"M0 0{arrow(known[0], -known[1])}", class_="arrow") if np.isfinite(d[:2]).any() else ""
    bar = tag("path", d=f"M0 0v{-known[2]:.1f}", class_="height") if np.isfinite(d[2]) else ""
    scaled = tag("g", planar + tag("g", bar, transform="translate(7 0)"), class_="scaled")
    label = tag("text", text(vectors.names[k][:LETTERS]), x=9, y=-7, class_="tick halo") if labelled else ""
    inside = words + tag("path", d=shape(0.0, 0.0, 4.0), class_="mark") + scaled + label
    return tag("g", inside, transform=f"translate({u:.1f} {v:.1f})", class_=kind, data_row=k)


def connection_drawing(plan: Plan, found: Connections, names: tuple[str, ...], unit: str) -> str:
    """Images as dots, their strongest connections as lines: thick with many common points, dashed with few."""
    (west, east), (south, north) = (limits(plan.stations[:, k], 0.06) for k in (0, 1))
    axes = plan_axes((west, south, east, north), highest=460)
    most = max(int(found.common.max(initial=1)), 1)
    lines, together = [], {}
    u, v = axes.u(plan.stations[:, 0]), axes.v(plan.stations[:, 1])
    drawn = (np.isfinite(u) & np.isfinite(v))[found.pairs].all(1)
    for (a, b), number in zip(found.pairs[drawn].tolist(), found.common[drawn].tolist(), strict=True):
        kind = "weak" if number < WEAK else f"w{min(4, int(5 * number / most))}"
        path = f"M{u[a]:.1f} {v[a]:.1f}l{u[b] - u[a]:.1f} {v[b] - v[a]:.1f}"
        if len(found.common) > MAX_TITLED:
            together.setdefault(kind, []).append(path)
        else:
            words = titled(f"{names[a]} - {names[b]}: {number} common points")
            lines.append(tag("path", words, d=path, class_=kind))
    lines += [tag("path", d="".join(paths), class_=kind) for kind, paths in sorted(together.items())]
    there = np.flatnonzero(np.isfinite(plan.stations[:, :2]).all(1))
    dots = [
        tag("circle", titled(f"image {names[k]}"), cx=a, cy=b, r=3.0) for k, a, b in _places(axes, plan.stations, there)
    ]
    inside = tag("g", lines, class_="links") + tag("g", dots, class_="dots") + scale_bar(axes, unit)
    return axes.picture(inside, "connections of the images")


def precision_drawing(found: PrecisionMap, plan: Plan, unit: str, name: str) -> str:
    """The map of the median standard deviation, logarithmic between its 2 % and 98 % quantiles, with its scale."""
    west, south, east, north = found.bounds
    axes = plan_axes(found.bounds, 560, 480)
    values = found.median[np.isfinite(found.median) & (found.median > 0)]
    low, high = (float(x) for x in np.quantile(values, [0.02, 0.98])) if len(values) else (1.0, 1.0)
    high = max(high, low * 1.05)
    with np.errstate(all="ignore"):
        share = np.log(found.median / low) / np.log(high / low)
    pixels = np.zeros((*found.median.shape, 4), np.uint8)
    pixels[..., :3] = viridis(share)
    pixels[..., 3] = np.where(np.isfinite(found.median), 255, 0)
    x, y = float(axes.u(west)), float(axes.v(north))
    width, height = float(axes.u(east)) - x, float(axes.v(south)) - y
    source = png(pixels[::-1])
    picture = tag(
        "image", href=source, preserveAspectRatio="none", x=x, y=y, width=width, height=height, class_="cells"
    )
    control = _there(plan.points)
    control = control[plan.role[control] == CONTROL_POINT]
    marks = [tag("path", d=triangle(u, v, 3.5)) for _, u, v in _places(axes, plan.points, control)]
    scale = _colour_scale(axes, low, high, unit)
    return axes.picture(picture + tag("g", marks, class_="control plain") + scale_bar(axes, unit) + scale, name)


def _colour_scale(axes: Axes, low: float, high: float, unit: str) -> str:
    """The legend: eight colours and the values at both ends."""
    left, y = axes.width * 0.46, axes.height - 22
    colours = viridis((np.arange(12) + 0.5) / 12).tolist()
    boxes = [
        tag("rect", x=left + 12 * k, y=y, width=12.0, height=10.0, fill=hexadecimal(tuple(colour)))
        for k, colour in enumerate(colours)
    ]
    ends = tag("text", f"{low:.2g}", x=left - 6, y=y + 9, class_="tick end")
    ends += tag("text", text(f"{high:.2g} {unit}"), x=left + 150, y=y + 9, class_="tick")
    return "".join(boxes) + ends


def field_drawing(field: Field, name: str) -> tuple[str, float]:
    """Mean residuals over the image format as arrows, and their factor; blue ones exceed 3 of their sd."""
    left, low, right, high = field.format
    axes = plan_axes((left, low, right, high), 440, 420)
    size = np.hypot(*field.mean.T)
    cell = np.hypot(right - left, high - low) / max(np.sqrt(len(field.rays)), 3.0)
    longest = float(np.quantile(size, 0.95)) if len(size) else 0.0
    factor = nice(0.9 * cell / longest) if longest > 0 else 1.0
    down = field.unit == "px"  # pixel coordinates v increase downwards, residuals are positive upwards in all images
    parts = [tag("path", d=square_of(axes, field.format), class_="format")]
    for x, y, (dx, dy), ratio, count in zip(
        field.x.tolist(), field.y.tolist(), field.mean.tolist(), field.ratio, field.rays.tolist(), strict=True
    ):
        u, v = float(axes.u(x)), float(axes.v(low + high - y if down else y))
        words = titled(f"vx {dx:.3g} vy {dy:.3g} {field.unit}, {count} rays, {np.abs(ratio).max():.1f} sd")
        kind = "arrow notable" if np.abs(ratio).max() > 3 else "arrow"
        length = factor * axes.scale
        parts.append(tag("path", words, d=f"M{u:.1f} {v:.1f}{arrow(dx * length, -dy * length)}", class_=kind))
    reference = nice(0.2 * (right - left) / factor)
    bar = reference * factor * axes.scale
    y = axes.height - 18
    parts.append(tag("path", d=f"M{axes.left} {y}{arrow(bar, 0.0)}", class_="axis arrow"))
    words = f"{reference:g} {field.unit} (x {factor:g})"
    parts.append(tag("text", text(words), x=axes.left + bar + 10, y=y + 4, class_="tick"))
    return axes.picture("".join(parts), name, class_="field"), factor


def square_of(axes: Axes, bounds: tuple[float, float, float, float]) -> str:
    """Path of a rectangle."""
    west, south, east, north = bounds
    return f"M{axes.u(west):.1f} {axes.v(south):.1f}H{axes.u(east):.1f}V{axes.v(north):.1f}H{axes.u(west):.1f}z"
