"""Plans in matplotlib: the block, arrows at control and check points, ellipses, connections, precision."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import LogNorm

from jaxbundle.plot.plot_axes import EXTERNAL, INTERNAL, PLAIN, begin, plan_view, styled
from jaxbundle.report.pictures import network, point_pictures, vector_pictures
from jaxbundle.report.pictures.known import known
from jaxbundle.report.pictures.plan_picture import CHECK_POINT, CONTROL_POINT, TIE, plan
from jaxbundle.solve.adjustment import Adjustment


def block(result: Adjustment, *, outlines: bool = True, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the block in plan view: stations, outlines of the images, control, check and tie points.

    Args:
        result: the adjustment.
        outlines: whether the area of the points of each image is drawn.
        ax: the axes to draw into; new ones if None.
        style: keywords of `Axes.plot` for the tie points.

    Returns: the axes.

    Example:
        >>> ax = jb.plot.block(result)
        >>> ax.get_xlabel()
        'X [m]'
    """
    figures, ax = begin(result, ax, "block")
    seen = plan(figures)
    if outlines:
        corners = [polygon for polygon in seen.outlines if len(polygon) > 2]
        ax.add_collection(PolyCollection(corners, facecolors="#005a9c14", edgecolors=INTERNAL, linewidths=0.5))
    kinds = ((TIE, "tie", ".", PLAIN, 2), (CONTROL_POINT, "control", "^", INTERNAL, 7))
    for role, label, marker, colour, size in (*kinds, (CHECK_POINT, "check", "s", EXTERNAL, 6)):
        xyz = seen.points[seen.role == role]
        if len(xyz):
            look = {"marker": marker, "color": colour, "markersize": size, "linestyle": "none", "label": label}
            ax.plot(xyz[:, 0], xyz[:, 1], **(styled(style, **look) if role == TIE else {**look, "fillstyle": "none"}))
    ax.plot(seen.stations[:, 0], seen.stations[:, 1], "k+", label="stations")
    ax.legend(loc="best", fontsize="small")
    return plan_view(ax, figures.structure.object_unit)


def control(result: Adjustment, *, factor: float | None = None, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the residuals of control points: arrows in X and Y, bars in Z, adjusted - observed.

    `factor`: enlargement, that of the report if None. Other arguments and the result as for `block`.

    Example:
        >>> ax = jb.plot.control(result, factor=100.0)
        >>> ax.get_xlabel()
        'X [m]'
    """
    return _differences(result, "control", factor, ax, style)


def check(result: Adjustment, *, factor: float | None = None, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the differences at check points: arrows in X and Y, bars in Z, adjusted - known. Else as for `control`.

    Example:
        >>> ax = jb.plot.check(result)
        >>> ax.get_xlabel()
        'X [m]'
    """
    return _differences(result, "check", factor, ax, style)


def _differences(result: Adjustment, kind: str, factor: float | None, ax: Axes | None, style: dict) -> Axes:
    figures, ax = begin(result, ax, kind)
    both = {"control": vector_pictures.control_vectors(figures), "check": vector_pictures.check_vectors(figures)}
    found, seen, unit = both[kind], plan(figures), figures.structure.object_unit
    if not found.names:
        raise ValueError(f"this block has no {kind} points with differences")
    xy = np.concatenate([seen.stations[:, :2], seen.points[:, :2]])
    extent = float(np.hypot(*(np.nanmax(xy, 0) - np.nanmin(xy, 0))))
    factor = vector_pictures.arrow_factor(list(both.values()), extent) if factor is None else factor
    colour = INTERNAL if kind == "control" else EXTERNAL
    x, y = found.position[:, 0], found.position[:, 1]
    d = np.nan_to_num(found.difference)
    look = styled(style, color=colour, angles="xy", scale_units="xy", scale=1 / factor, width=0.004)
    ax.quiver(x, y, d[:, 0], d[:, 1], **look)
    bars = np.stack([np.stack([x, y], 1), np.stack([x, y + factor * d[:, 2]], 1)], 1)
    ax.add_collection(LineCollection(list(bars), colors=colour, linewidths=4, alpha=0.4))
    ax.plot(x, y, "^" if kind == "control" else "s", color=colour, fillstyle="none", linestyle="none")
    for name, a, b in zip(found.names, x, y, strict=True):
        ax.annotate(name, (a, b), xytext=(5, 5), textcoords="offset points", fontsize="small")
    ax.set_title(f"{kind} points, differences x {factor:g}", fontsize="medium")
    return plan_view(ax, unit)


def ellipses(result: Adjustment, *, factor: float = 1000.0, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the error ellipses of the stations, one standard deviation, enlarged by `factor`. Else as for `block`.

    Raises: ValueError where there are no standard deviations.

    Example:
        >>> ax = jb.plot.ellipses(result, factor=500.0)
        >>> ax.get_xlabel()
        'X [m]'
    """
    figures, ax = begin(result, ax, "ellipses")
    if result.cofactors is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    q = figures.sigma0**2 * known(np.asarray(result.cofactors.exterior)[:, :2, :2])
    values, directions = np.linalg.eigh(np.nan_to_num(q))
    width, height = (2 * factor * np.sqrt(np.maximum(values[:, k], 0.0)) for k in (1, 0))
    angle = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    stations = known(figures.exterior[:, :2])
    look = styled(style, facecolors="none", edgecolors=INTERNAL)
    ax.add_collection(
        EllipseCollection(width, height, angle, units="xy", offsets=stations, offset_transform=ax.transData, **look)
    )
    ax.plot(stations[:, 0], stations[:, 1], "k+")
    ax.set_title(f"error ellipses of the stations x {factor:g}", fontsize="medium")
    return plan_view(ax, figures.structure.object_unit)


def connections(result: Adjustment, *, least: int = 1, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws connections of images with at least `least` common points; weak ones are dashed. Else as for `block`.

    Example:
        >>> ax = jb.plot.connections(result)
        >>> ax.get_ylabel()
        'Y [m]'
    """
    figures, ax = begin(result, ax, "connections")
    found, xy = network.connections(figures), known(figures.exterior[:, :2])
    kept = found.common >= least
    pairs, common = found.pairs[kept], found.common[kept]
    weak = common < network.WEAK
    width = 0.5 + 3 * common / max(int(common.max(initial=1)), 1)
    look = styled(style, colors=[EXTERNAL if w else INTERNAL for w in weak], linewidths=width)
    ax.add_collection(LineCollection(list(xy[pairs]), linestyles=["--" if w else "-" for w in weak], **look))
    ax.plot(xy[:, 0], xy[:, 1], "o", color=INTERNAL, markersize=3)
    return plan_view(ax, figures.structure.object_unit)


def precision_map(result: Adjustment, component: str = "Z", *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the median standard deviation of X, Y or Z over the block, on a logarithmic scale. Else as for `block`.

    Example:
        >>> ax = jb.plot.precision_map(result, "Z")
        >>> ax.get_xlabel()
        'X [m]'
    """
    figures, ax = begin(result, ax, "precision_map")
    found = point_pictures.precision_map(figures, component)
    if not np.isfinite(found.median).any():
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    west, south, east, north = found.bounds
    look = styled(style, cmap="viridis", norm=LogNorm(), origin="lower", extent=(west, east, south, north))
    picture = ax.imshow(found.median, **look)
    unit = figures.structure.object_unit
    if ax.figure is not None:
        ax.figure.colorbar(picture, ax=ax, label=f"sd {component} [{unit}], median of a cell")
    return plan_view(ax, unit)
