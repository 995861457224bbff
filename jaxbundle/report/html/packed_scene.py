"""The block as data for the script of the page: positions on a grid of 16 bits, packed, and some names."""

import base64
import json
import zlib
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxbundle.report.figures import Figures
from jaxbundle.report.html.drawings import thinned
from jaxbundle.report.pictures.known import known, limits
from jaxbundle.report.pictures.plan_picture import CHECK_POINT, TIE, Plan

MOST_TIES = 250_000  # maximum number of points for the script; evenly spread if there are more
MOST_NAMED = 10_000  # maximum number of points with names in the page
GRID = 65535
DIGITS = 6  # digits of a coordinate in the data: a millionth of the block


def scene(figures: Figures, plan: Plan) -> tuple[str, str]:
    """The data as JSON for a page, and a sentence about the number of points in it."""
    finite = np.isfinite(plan.points).all(1)
    tie = np.flatnonzero(finite & (plan.role == TIE))
    shown = tie[thinned(len(tie), MOST_TIES)]
    everything = np.concatenate([plan.stations[np.isfinite(plan.stations).all(1)], plan.points[finite]])
    bounds = np.array([limits(column, 0.0) for column in everything.T.reshape(3, -1)])
    origin, extent = bounds[:, 0], float(np.ptp(bounds, axis=1).max())
    step = 10.0 ** np.floor(np.log10(extent)) / 10**DIGITS if extent > 0 else 1.0
    ground = plan.points[finite, 2]
    level = float(np.median(ground)) - origin[2] if len(ground) else 0.0

    def rounded(values: np.ndarray) -> list:
        return (np.round(values / step) * step).round(9).tolist()

    there = np.flatnonzero(np.isfinite(plan.stations).all(1))
    marked = np.flatnonzero(finite & (plan.role != TIE))
    rows = _table_rows(figures)
    names = figures.structure.point_names
    data: dict[str, Any] = {
        "unit": figures.structure.object_unit,
        "origin": origin.tolist(),
        "size": (bounds[:, 1] - origin).tolist(),
        "level": level,
        "stations": [
            [*xyz, figures.structure.image_names[k], f"images-{k}"]
            for k, xyz in zip(there.tolist(), rounded(plan.stations[there] - origin), strict=True)
        ],
        "outlines": [rounded(plan.outlines[k].ravel() - np.tile(origin[:2], len(plan.outlines[k]))) for k in there],
        "marks": [
            [*xyz, names[p], rows.get(p, f"points-{p}"), int(plan.role[p] == CHECK_POINT)]
            for p, xyz in zip(marked.tolist(), rounded(plan.points[marked] - origin), strict=True)
        ],
        "ties": _packed(figures, plan.points[shown], shown),
    }
    if len(shown) <= MOST_NAMED:
        data["names"] = [names[p] for p in shown.tolist()]
        data["rows"] = shown.tolist()
    words = f"{len(shown)} of {len(tie)} tie points are in this plan"
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"), words


def _table_rows(figures: Figures) -> dict[int, str]:
    """Ids of the table rows of control and check points."""
    index = {name: k for k, name in enumerate(figures.structure.point_names)}
    rows = {int(p): f"check_points-{k}" for k, p in enumerate(figures.structure.check_point)}
    for table in figures.tables:
        if table.name == "control":
            rows |= {index[name]: f"control-{k}" for k, name in enumerate(table.who["point"])}
    return rows


def _packed(figures: Figures, xyz: Float[np.ndarray, "point 3"], rows: np.ndarray) -> dict[str, Any]:
    """Positions as 16 bits between their limits, X of all, then Y, then Z, then the logarithm of the maximum standard
    deviation as 8 bits; deflated (RFC 1951), in base64."""
    bounds = np.array([limits(column, 0.0) for column in xyz.T])
    size = bounds[:, 1] - bounds[:, 0]
    grid = np.round((xyz - bounds[:, 0]) / size * GRID).astype("<u2")
    sd = known(figures.points_sd[rows])
    sd = np.where(np.isfinite(sd).any(1), np.nan_to_num(sd).max(1, initial=0.0), np.nan)
    good = sd[np.isfinite(sd) & (sd > 0)]
    low, high = np.quantile(good, [0.02, 0.98]) if len(good) else (1.0, 1.0)
    high = max(high, low * 1.05)
    with np.errstate(all="ignore"):
        share = np.log(sd / low) / np.log(high / low)
    shade = np.where(np.isfinite(share), np.clip(np.nan_to_num(share), 0, 1) * 254 + 1, 0).astype(np.uint8)
    squeezed = zlib.compressobj(9, zlib.DEFLATED, -15)
    raw = squeezed.compress(grid.T.tobytes() + shade.tobytes()) + squeezed.flush()
    return {
        "count": len(xyz),
        "low": (bounds[:, 0]).tolist(),
        "size": size.tolist(),
        "sd": [float(low), float(high)],
        "data": base64.b64encode(raw).decode(),
    }
