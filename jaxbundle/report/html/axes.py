"""Axes of a chart in SVG: numbers to picture coordinates, with ticks, labels and frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxbundle.report.html.markup import tag, text
from jaxbundle.report.pictures.known import known, nice

HEAD = 5.0  # length of the head of an arrow in the picture
LOG_FLOOR = 1e-300  # the logarithm of 0 is not finite


@dataclass(frozen=True)
class Axes:
    """Limits in x and y, size of the picture and its margins. `log_x`, `log_y`: the limits are powers of ten."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float = 430
    height: float = 260
    left: float = 56
    right: float = 14
    top: float = 26
    bottom: float = 44
    log_x: bool = False
    log_y: bool = False

    def u(self, x: np.ndarray | float) -> Float[np.ndarray, "..."]:
        """Horizontal picture coordinates of values."""
        share = _share(x, self.x, self.log_x)
        return np.asarray(self.left + share * (self.width - self.left - self.right))

    def v(self, y: np.ndarray | float) -> Float[np.ndarray, "..."]:
        """Vertical picture coordinates of values, downwards."""
        share = _share(y, self.y, self.log_y)
        return np.asarray(self.height - self.bottom - share * (self.height - self.top - self.bottom))

    @property
    def scale(self) -> float:
        """Length in the picture of one unit of x."""
        return (self.width - self.left - self.right) / (self.x[1] - self.x[0])

    def frame(self, across: str, up: str, categories: Sequence[str] = ()) -> str:
        """Ticks and labels of both axes; `categories`: names of 0, 1, ... on the horizontal axis."""
        parts, end = [], self.height - self.bottom
        for value, label in list(enumerate(categories)) or _ticks(self.x, self.log_x, 7):
            place = float(self.u(value))
            if not categories:
                parts.append(tag("line", x1=place, x2=place, y1=self.top, y2=end, class_="grid"))
            parts.append(tag("text", text(label), x=place, y=end + 16, class_="tick middle"))
        for value, label in _ticks(self.y, self.log_y, 6):
            place = float(self.v(value))
            parts.append(tag("line", x1=self.left, x2=self.width - self.right, y1=place, y2=place, class_="grid"))
            parts.append(tag("text", label, x=self.left - 6, y=place + 4, class_="tick end"))
        parts.append(tag("path", d=f"M{self.left} {self.top}V{end}H{self.width - self.right}", class_="axis"))
        middle = 0.5 * (self.left + self.width - self.right)
        parts.append(tag("text", text(across), x=middle, y=self.height - 8, class_="label middle"))
        parts.append(tag("text", text(up), x=6.0, y=12.0, class_="label"))
        return "".join(parts)

    def picture(self, inside: str, name: str, **attributes: object) -> str:
        """The complete SVG of a picture."""
        box = f"0 0 {self.width:g} {self.height:g}"
        return tag("svg", inside, viewBox=box, role="img", aria_label=name, **attributes)

    def line(self, x: np.ndarray, y: np.ndarray, kind: str) -> str:
        """A line through points; it is interrupted where a number is unknown."""
        u, v = self.u(known(x)), self.v(known(y))
        steps, pen = [], "M"
        for a, b in zip(u.tolist(), v.tolist(), strict=True):
            if math.isfinite(a) and math.isfinite(b):
                steps.append(f"{pen}{a:.1f} {b:.1f}")
                pen = "L"
            else:
                pen = "M"
        return tag("path", d="".join(steps), class_=kind) if steps else ""


def _share(values: np.ndarray | float, bounds: tuple[float, float], log: bool) -> Float[np.ndarray, "..."]:
    low, high = bounds
    values = np.asarray(values, float)
    if log:
        with np.errstate(all="ignore"):
            values = np.log10(np.maximum(values, LOG_FLOOR))
        low, high = math.log10(low), math.log10(high)
    return np.asarray(np.clip((values - low) / (high - low), -0.5, 1.5))


def _ticks(bounds: tuple[float, float], log: bool, count: int) -> list[tuple[float, str]]:
    low, high = bounds
    if log:
        powers = range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)
        step = max(1, math.ceil(len(powers) / count))
        return [(10.0**k, f"1e{k}" if abs(k) > 3 else f"{10.0**k:g}") for k in powers if k % step == 0]
    step = nice((high - low) / count * 1.9)
    first = math.ceil(low / step - 1e-9)
    values = [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    if decimals > 5 or abs(high) >= 1e7:
        return [(value, f"{value:.4g}") for value in values]
    return [(value, f"{value:.{decimals}f}") for value in values]


def arrow(du: float, dv: float) -> str:
    """Path of an arrow; short arrows have no head."""
    length = math.hypot(du, dv)
    if not length > 5:
        return f"l{du:.1f} {dv:.1f}"
    a, b = du / length * HEAD, dv / length * HEAD
    left, right = (-a - b / 2, -b + a / 2), (-a + b / 2, -b - a / 2)
    barbs = f"m{left[0]:.1f} {left[1]:.1f}l{-left[0]:.1f} {-left[1]:.1f}l{right[0]:.1f} {right[1]:.1f}"
    return f"l{du:.1f} {dv:.1f}{barbs}"


def log_limits(values: np.ndarray) -> tuple[float, float]:
    """Powers of ten around the positive values."""
    values = known(values)
    values = values[np.isfinite(values) & (values > 1e-290)]
    if not len(values):
        return 0.1, 10.0
    low, high = math.floor(math.log10(values.min())), math.ceil(math.log10(values.max()))
    return 10.0**low, 10.0 ** max(high, low + 1)


def plan_axes(bounds: tuple[float, float, float, float], width: float = 760, highest: float = 560) -> Axes:
    """Axes of equal scales for a plan; `bounds`: minimum x, minimum y, maximum x, maximum y."""
    west, south, east, north = bounds
    across, up = east - west, north - south
    inner = width - 24
    height = up / across * inner
    if height > highest:
        height = highest
        missing = up / height * inner - across
        west, east = west - missing / 2, east + missing / 2
    if height < 120:
        missing = across * 120 / inner - up
        south, north, height = south - missing / 2, north + missing / 2, 120.0
    return Axes((west, east), (south, north), width, height + 60, 12, 12, 12, 48)


def scale_bar(axes: Axes, unit: str, north: bool = True) -> str:
    """A scale bar of a round length below the plan, and a north arrow (towards larger Y)."""
    length = nice(140 / axes.scale)
    size, y = length * axes.scale, axes.height - 16
    words = f"{length:g} {unit}"
    parts = [
        tag("path", d=f"M{axes.left} {y - 5:.1f}v5h{size:.1f}v-5m{-size / 2:.1f} 5v-3", class_="axis"),
        tag("text", text(words), x=axes.left + size + 8, y=y + 1, class_="tick"),
    ]
    if north:
        u = axes.width - axes.right - 12
        parts.append(tag("path", d=f"M{u} {y - 28:.1f}l6 22l-6 -5l-6 5z", class_="north"))
        parts.append(tag("text", "Y", x=u, y=y + 10, class_="tick middle"))
    return "".join(parts)
