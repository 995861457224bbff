"""The block as data for the script of the page: positions on a grid of 16 bits, packed, and some names."""

import base64
import json
import zlib
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.report.figures import Figures
from jaxbundle.report.html.drawings import thinned
from jaxbundle.report.pictures.known import known, limits
from jaxbundle.report.pictures.plan_picture import CHECK_POINT, TIE, Plan
from jaxbundle.report.pictures.vector_pictures import rows_of

MAX_TIES = 250_000  # maximum number of points for the script; evenly spread if there are more
MAX_NAMED = 10_000  # maximum number of points with names in the page
GRID = 65535
ROWS_OF_GRID = 256  # the points are packed in strips with this number of steps in Y
SHADES = 63  # shades of precision: neighbouring shades cannot be distinguished
DIGITS = 6  # digits of a coordinate in the data: a millionth of the block
DIGITS_OF_OUTLINES = 4


def scene(figures: Figures, plan: Plan) -> tuple[str, str]:
    """The data as JSON for a page, and a sentence about the number of points in it."""
    finite = np.isfinite(plan.points).all(1)
    tie = np.flatnonzero(finite & (plan.role == TIE))
    shown = tie[thinned(len(tie), MAX_TIES)]
    grid, bounds_of_grid = _grid(plan.points[shown])
    order = np.lexsort((grid[:, 0], grid[:, 1] // ROWS_OF_GRID))
    shown, grid = shown[order], grid[order]
    everything = np.concatenate([plan.stations[np.isfinite(plan.stations).all(1)], plan.points[finite]])
    bounds = np.array([limits(column, 0.0) for column in everything.T.reshape(3, -1)])
    origin, extent = bounds[:, 0], float(np.ptp(bounds, axis=1).max())
    power = 10.0 ** np.floor(np.log10(extent)) if extent > 0 else 1.0
    ground = plan.points[finite, 2]
    level = float(np.median(ground)) - origin[2] if len(ground) else 0.0

    def rounded(values: np.ndarray, digits: int = DIGITS) -> list:
        step = power / 10**digits
        numbers = (np.round(values / step) * step).round(9)
        return (numbers.astype(int) if step >= 1 else numbers).tolist()

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
        "outlines": [rounded((plan.outlines[k] - origin[:2]).ravel(), DIGITS_OF_OUTLINES) for k in there],
        "marks": [
            [*xyz, names[p], rows.get(p, f"points-{p}"), int(plan.role[p] == CHECK_POINT)]
            for p, xyz in zip(marked.tolist(), rounded(plan.points[marked] - origin), strict=True)
        ],
        "ties": _packed(grid, bounds_of_grid, known(figures.points_sd[shown])),
    }
    if len(shown) <= MAX_NAMED:
        data["names"] = [names[p] for p in shown.tolist()]
        data["rows"] = shown.tolist()
    words = f"{len(shown)} of {len(tie)} tie points are in this plan"
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"), words


def _table_rows(figures: Figures) -> dict[int, str]:
    """Ids of the table rows of control and check points."""
    rows = {int(p): f"check_points-{k}" for k, p in enumerate(figures.structure.check_point)}
    for table in figures.tables:
        if table.name == "control":
            index = rows_of(table.who["point"], figures.structure.point_names)
            rows |= {index[name]: f"control-{k}" for k, name in enumerate(table.who["point"])}
    return rows


def _grid(xyz: Float[np.ndarray, "point 3"]) -> tuple[Int[np.ndarray, "point 3"], Float[np.ndarray, "2 3"]]:
    """Positions on a grid of 16 bits, its origin and its size.

    Of many points, which have no names in the page, the steps are the same in X, Y and Z: most blocks are flat, so that
    few heights differ.
    """
    bounds = np.array([limits(column, 0.0) for column in xyz.T])
    low, size = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
    if len(xyz) > MAX_NAMED:
        size = np.full(3, size.max())
    return np.round((xyz - low) / size * GRID).astype(int), np.stack([low, size])


def _packed(
    grid: Int[np.ndarray, "point 3"], bounds: Float[np.ndarray, "2 3"], sd: Float[np.ndarray, "point 3"]
) -> dict[str, Any]:
    """Positions and the logarithm of the largest standard deviation, deflated (RFC 1951), in base64.

    The points come in strips of Y, with rising X in each of them. X is stored as the difference from the point before,
    modulo 2^16. All low bytes of X come first, then all high bytes; then Y and Z alike, then one byte of precision.
    """
    sd = np.where(np.isfinite(sd).any(1), np.nan_to_num(sd).max(1, initial=0.0), np.nan)
    good = sd[np.isfinite(sd) & (sd > 0)]
    low, high = np.quantile(good, [0.02, 0.98]) if len(good) else (1.0, 1.0)
    high = max(high, low * 1.05)
    with np.errstate(all="ignore"):
        share = np.log(sd / low) / np.log(high / low)
    steps = np.round(np.clip(np.nan_to_num(share), 0, 1) * SHADES) * (254 // SHADES) + 1
    shade = np.where(np.isfinite(share), steps, 0).astype(np.uint8)
    columns = [np.diff(grid[:, 0], prepend=0), grid[:, 1], grid[:, 2]]
    planes = [(column >> shift) & 255 for column in columns for shift in (0, 8)]
    squeezed = zlib.compressobj(6, zlib.DEFLATED, -15)
    raw = squeezed.compress(np.stack([*planes, shade]).astype(np.uint8).tobytes()) + squeezed.flush()
    return {
        "count": len(grid),
        "low": bounds[0].tolist(),
        "size": bounds[1].tolist(),
        "sd": [float(low), float(high)],
        "data": base64.b64encode(raw).decode(),
    }
