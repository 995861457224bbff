"""Cameras in matplotlib: mean residual field, distortion with its band, correlations."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxbundle.plot.plot_axes import INTERNAL, begin, index_of, styled
from jaxbundle.report.pictures import camera_pictures, ray_pictures
from jaxbundle.solve.adjustment import Adjustment


def residual_field(
    result: Adjustment,
    camera: str | int = 0,
    *,
    bins: tuple[int, int] = ray_pictures.CELLS,
    ax: Axes | None = None,
    **style: Any,
) -> Axes:
    """Draws the mean residuals of a camera over its format; y of residuals points up.

    Args:
        result: the adjustment.
        camera: its name or index.
        bins: maximum number of rows and columns of the grid; with few rays the cells are larger.
        ax: the axes to draw into; new ones if None.
        style: keywords of `Axes.quiver` for the arrows.

    Returns: the axes.

    Raises: ValueError for an unknown camera.

    Example:
        >>> ax = jb.plot.residual_field(result, "drone")
        >>> ax.get_xlabel() != ""
        True
    """
    figures, ax = begin(result, ax, "residual_field")
    c = index_of(camera, figures.camera_names, "camera")
    found = ray_pictures.residual_field(figures, c, bins)
    down = found.unit == "px"
    ax.quiver(found.x, found.y, found.mean[:, 0], found.mean[:, 1], **styled(style, color=INTERNAL, angles="uv"))
    left, low, right, high = found.format
    ax.set_xlim(left, right)
    ax.set_ylim(*((high, low) if down else (low, high)))
    ax.set_aspect("equal")
    ax.set_xlabel(f"x [{found.unit}]")
    ax.set_ylabel(f"y [{found.unit}]")
    ax.set_title(f"mean residuals, camera {figures.camera_names[c]}", fontsize="medium")
    return ax


def distortion(result: Adjustment, camera: str | int = 0, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the radial distortion of a camera with a band of one standard deviation. Arguments as for `residual_field`.

    Raises: ValueError also for a camera model without radial coefficients.

    Example:
        >>> jb.plot.distortion(result, "drone")  # the camera of this block has no distortion
        Traceback (most recent call last):
            ...
        ValueError: ...
    """
    figures, ax = begin(result, ax, "distortion")
    c = index_of(camera, figures.camera_names, "camera")
    found = camera_pictures.distortion(figures, c)
    if found is None:
        raise ValueError(f"the model of camera {figures.camera_names[c]!r} has no radial coefficients K1 or k1")
    if np.isfinite(found.sd).all():
        low, high = found.distortion - found.sd, found.distortion + found.sd
        ax.fill_between(found.radius, low, high, color=INTERNAL, alpha=0.2, linewidth=0)
    ax.plot(found.radius, found.distortion, **styled(style, color=INTERNAL))
    ax.set_xlabel(f"radius [{found.unit}]")
    ax.set_ylabel(f"radial distortion [{found.unit}]")
    return ax


def correlations(result: Adjustment, camera: str | int = 0, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the correlations of the estimated elements of a camera, with their numbers. Else as for `residual_field`.

    Raises: ValueError also where fewer than two elements are estimated, or no standard deviations were computed.

    Example:
        >>> jb.plot.correlations(result, "drone")  # the camera of this block is fixed
        Traceback (most recent call last):
            ...
        ValueError: ...
    """
    figures, ax = begin(result, ax, "correlations")
    c = index_of(camera, figures.camera_names, "camera")
    found = camera_pictures.correlations(figures, c)
    if found is None:
        raise ValueError(
            f"camera {figures.camera_names[c]!r} has no correlations: estimate two elements, with precision=True"
        )
    ax.imshow(found.matrix, **styled(style, cmap="PuOr_r", vmin=-1.0, vmax=1.0))
    ax.set_xticks(range(len(found.elements)), found.elements, rotation=45, ha="right")
    ax.set_yticks(range(len(found.elements)), found.elements)
    for (i, k), r in np.ndenumerate(found.matrix):
        colour = "white" if abs(r) > 0.7 else "black"
        ax.text(k, i, f"{r:.2f}", ha="center", va="center", color=colour, fontsize="small")
    return ax
