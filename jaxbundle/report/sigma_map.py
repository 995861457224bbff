"""A map of predicted standard deviations as SVG: coloured points, control, stations, and the worst point."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Bool, Float

WIDTH, MARGIN, LEGEND = 900.0, 40.0, 70.0  # px
# from dark blue through green to yellow: viridis (Smith & van der Walt 2015), readable in grey and by the colour-blind
COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
STEPS = 6  # of the legend


class Map(NamedTuple):
    """Content of a map, in object coordinates."""

    title: str
    unit: str
    points: Float[np.ndarray, "point 2"]
    sigmas: Float[np.ndarray, " point"]
    """Meaning of the colours; points without a finite sigma are left out."""
    control: Bool[np.ndarray, " point"]
    stations: Float[np.ndarray, "image 2"]
    names: Sequence[str]


def sigma_map(shown: Map) -> str:
    """The map as the text of an SVG file.

    Args:
        shown: points with their standard deviations, control points and stations.

    Returns: SVG; triangles are control points, crosses are stations, the ring is the point with the maximum sigma.
    """
    every = np.concatenate([shown.points, shown.stations])
    low, high = every.min(0), every.max(0)
    size = np.maximum(high - low, 1e-9 * max(float(np.abs(every).max()), 1.0))
    scale = (WIDTH - 2 * MARGIN) / max(size)
    height = size[1] * scale + 2 * MARGIN + LEGEND

    def at(xy: Float[np.ndarray, "2"]) -> tuple[float, float]:
        x, y = (xy - low) * scale
        return MARGIN + float(x), MARGIN + 30 + float(size[1] * scale - y)

    judged = np.flatnonzero(~shown.control & np.isfinite(shown.sigmas))
    values = shown.sigmas[judged]
    least, most = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:.0f}" height="{height:.0f}" font-family="sans-serif"'
        f' font-size="14"><rect width="100%" height="100%" fill="white"/>',
        f'<text x="{MARGIN}" y="28">{escape(shown.title)}</text>',
    ]
    for station in shown.stations:
        x, y = at(station)
        parts.append(f'<path d="M{x - 4:.1f} {y:.1f}h8M{x:.1f} {y - 4:.1f}v8" stroke="#bbb"/>')
    for k in judged:
        x, y = at(shown.points[k])
        share = (shown.sigmas[k] - least) / (most - least or 1.0)
        told = f"{escape(shown.names[int(k)])}: {shown.sigmas[k]:.4g} {shown.unit}"
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="{_colour(share)}"><title>{told}</title></circle>'
        )
    for k in np.flatnonzero(shown.control):
        x, y = at(shown.points[k])
        parts.append(
            f'<path d="M{x:.1f} {y - 8:.1f}l7 13h-14z" fill="none" stroke="red" stroke-width="2">'
            f"<title>control {escape(shown.names[int(k)])}</title></path>"
        )
    if len(judged):
        x, y = at(shown.points[judged[values.argmax()]])
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="none" stroke="black" stroke-width="2"/>')
    return "\n".join([*parts, *_legend(least, most, shown.unit, height), "</svg>"]) + "\n"


def _legend(least: float, most: float, unit: str, height: float) -> list[str]:
    parts = []
    for k, share in enumerate(np.linspace(0, 1, STEPS)):
        x, y = MARGIN + 140 * k, height - 24
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="{_colour(float(share))}"/>')
        parts.append(f'<text x="{x + 12:.1f}" y="{y + 5:.1f}">{least + share * (most - least):.3g} {unit}</text>')
    return parts


def _colour(share: float) -> str:
    place = min(max(share, 0.0), 1.0) * (len(COLOURS) - 1)
    k = min(int(place), len(COLOURS) - 2)
    r, g, b = np.round(COLOURS[k] + (place - k) * (COLOURS[k + 1] - COLOURS[k])).astype(int)
    return f"#{r:02x}{g:02x}{b:02x}"
