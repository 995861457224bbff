"""Drawing a comparison of two results in matplotlib."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxbundle.block.given import require_a
from jaxbundle.plot.plot_axes import EXTERNAL, INTERNAL, PLAIN, new_axes, styled
from jaxbundle.report.comparison import compare_reports
from jaxbundle.report.data import dict_of
from jaxbundle.report.figures import figures_of
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjustment import Adjustment

WIDEST = 6.0  # edges of the classes of t


def compare(first: Adjustment, second: Adjustment, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws a histogram of differences of point coordinates, second - first, over their standard deviations.

    Args:
        first: an adjustment.
        second: another one, with the same names of points.
        ax: the axes to draw into; new ones if None.
        style: keywords of `Axes.stairs` for the steps.

    Returns: the axes.

    Raises: ValueError where they have no point with standard deviations in common.

    Example:
        >>> ax = jb.plot.compare(result, result)
        >>> ax.get_xlabel() != ""
        True
    """
    found = compare_reports(_data(first), _data(second))
    points = next((table for table in found.differences if table.table == "points"), None)
    if points is None or not np.isfinite(points.ratio).any():
        raise ValueError("the results have no point with standard deviations in common")
    ax = new_axes(ax)
    edges = np.linspace(-WIDEST, WIDEST, 61)
    for column, name, colour in zip(points.ratio.T, points.columns, (INTERNAL, EXTERNAL, PLAIN), strict=False):
        t = np.clip(column[np.isfinite(column)], -WIDEST, WIDEST)
        ax.stairs(np.histogram(t, edges)[0], edges, **styled(style, color=colour, label=name))
    ax.set_xlabel("difference / standard deviation")
    ax.set_ylabel("number")
    ax.legend(fontsize="small")
    return ax


def _data(result: Adjustment) -> dict[str, Any]:
    """The content of report.json without the findings, because their computation takes longer than drawing."""
    require_a(Adjustment, result, "plot.compare")
    figures = figures_of(result, ())
    return dict_of(figures, [section() for section in sections_of(figures)])
