"""Common start of all plots: the numbers of a result, and axes to draw into."""

from typing import Any

import numpy as np

from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.solve.adjustment import Adjustment

try:
    from matplotlib import pyplot
    from matplotlib.axes import Axes
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("jb.plot needs matplotlib: pip install 'jaxbundle[plot]'") from error

INTERNAL, EXTERNAL, PLAIN = "#005a9c", "#b84a05", "#7c8890"  # suitable for colour-blind readers, as in the report


def begin(result: Adjustment, ax: Axes | None, name: str) -> tuple[Figures, Axes]:
    """The numbers of a result without findings, and the axes; new axes if None."""
    require_a(Adjustment, result, f"plot.{name}")
    require_photographs(result.block, f"plot.{name}")
    with np.errstate(all="ignore"):
        return figures_of(result, ()), new_axes(ax)


def new_axes(ax: Axes | None) -> Axes:
    """The given axes, or new ones if None."""
    return pyplot.subplots(layout="constrained")[1] if ax is None else ax


def plan_view(ax: Axes, unit: str) -> Axes:
    """Sets equal scales and labels both axes with the unit."""
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.12)  # arrows and ellipses do not affect the limits
    ax.set_xlabel(f"X [{unit}]")
    ax.set_ylabel(f"Y [{unit}]")
    return ax


def index_of(name: str | int, names: tuple[str, ...], what: str) -> int:
    """The index of a camera or an image by its name, or the index itself.

    Raises: ValueError for an unknown name.
    """
    if isinstance(name, int | np.integer) and 0 <= name < len(names):
        return int(name)
    if name not in names:
        raise ValueError(f"there is no {what} {name!r}; there are {', '.join(names[:6])}")
    return names.index(str(name))


def styled(style: dict[str, Any], **defaults: Any) -> dict[str, Any]:
    """The keywords of the caller, with defaults for the others."""
    return {**defaults, **style}
