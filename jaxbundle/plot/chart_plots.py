"""Charts in matplotlib: residuals, images, reliability, iterations, heights over the block."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxbundle.plot.plot_axes import EXTERNAL, INTERNAL, begin, index_of, styled
from jaxbundle.report.pictures import ray_pictures
from jaxbundle.report.pictures.doming import dome
from jaxbundle.report.pictures.known import known
from jaxbundle.solve.adjustment import Adjustment

OF_IMAGES = {"rms": "rms w / sigma0", "largest": "largest w / sigma0", "rays": "rays", "coverage": "covered share"}


def residual_histogram(result: Adjustment, *, log: bool = False, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws histograms of w / sigma0 of the rays for x and y, with the normal distribution.

    Args:
        result: the adjustment.
        log: whether the counts have a logarithmic scale.
        ax: the axes to draw into; new ones if None.
        style: keywords of `Axes.stairs` for the steps.

    Returns: the axes.

    Example:
        >>> ax = jb.plot.residual_histogram(result)
        >>> ax.get_xlabel() != ""
        True
    """
    figures, ax = begin(result, ax, "residual_histogram")
    edges, counts = ray_pictures.residual_histogram(figures)
    for row, colour, name in zip(counts, (INTERNAL, EXTERNAL), "xy", strict=False):
        ax.stairs(row, edges, **styled(style, color=colour, label=name))
    x = np.linspace(edges[0], edges[-1], 200)
    expected = counts.sum(1).max(initial=0) * (edges[1] - edges[0]) * np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    ax.plot(x, expected, "k--", linewidth=1, label="normal")
    if log:
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.5)
    ax.set_xlabel("w / sigma0")
    ax.set_ylabel("number")
    ax.legend(fontsize="small")
    return ax


def images(result: Adjustment, what: str = "rms", *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws one number of each image in order: "rms", "largest", "rays" or "coverage". Else as `residual_histogram`.

    Raises: ValueError for any other `what`.

    Example:
        >>> ax = jb.plot.images(result, "rms")
        >>> ax.get_ylabel() != ""
        True
    """
    if what not in OF_IMAGES:
        raise ValueError(f"what={what!r} is not one of {', '.join(OF_IMAGES)}")
    figures, ax = begin(result, ax, "images")
    found = ray_pictures.image_figures(figures)
    values = {"rms": found.standardised, "largest": found.largest, "rays": found.rays, "coverage": found.coverage}
    names = figures.structure.image_names
    ax.plot(np.arange(len(names)), values[what], **styled(style, marker="o", linestyle="none", color=INTERNAL))
    if what == "rms":
        ax.axhline(1.0, color="black", linestyle="--", linewidth=1)
    if len(names) <= 40:
        ax.set_xticks(range(len(names)), names, rotation=90, fontsize="small")
    ax.set_ylim(0.0, 1.15 * max(float(np.nanmax(np.append(values[what], 0.0))), 1e-9))
    ax.set_ylabel(OF_IMAGES[what])
    return ax


def image_residuals(
    result: Adjustment, image: str | int, *, factor: float | None = None, ax: Axes | None = None, **style: Any
) -> Axes:
    """Draws the residuals of one image as arrows at its points, enlarged by `factor`; matplotlib's choice if None.

    Raises: ValueError for an unknown image.

    Example:
        >>> ax = jb.plot.image_residuals(result, "11")
        >>> ax.get_xlabel() != ""
        True
    """
    figures, ax = begin(result, ax, "image_residuals")
    structure = figures.structure
    k = index_of(image, structure.image_names, "image")
    mine = structure.ray_image == k
    xy, v = np.asarray(result.block.rays.coordinates)[mine], known(figures.residuals[0][mine])
    scale = {} if factor is None else {"scale": 1 / factor, "scale_units": "x"}
    ax.quiver(xy[:, 0], xy[:, 1], v[:, 0], v[:, 1], **styled(style, color=INTERNAL, angles="uv", **scale))
    camera = int(structure.image_camera[k])
    left, low, right, high = ray_pictures.image_format(figures, camera)
    unit = structure.cameras[camera].image_unit
    ax.set_xlim(left, right)
    ax.set_ylim(*((high, low) if unit == "px" else (low, high)))
    ax.set_aspect("equal")
    ax.set_xlabel(f"x [{unit}]")
    ax.set_ylabel(f"y [{unit}]")
    ax.set_title(f"image {structure.image_names[k]}", fontsize="medium")
    return ax


def redundancy(result: Adjustment, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the histogram of the redundancy numbers of the image coordinates. Else as `residual_histogram`.

    Raises: ValueError where there are none.

    Example:
        >>> ax = jb.plot.redundancy(result)
        >>> ax.get_xlabel() != ""
        True
    """
    figures, ax = begin(result, ax, "redundancy")
    if figures.reliability is None:
        raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
    r = np.clip(np.nan_to_num(figures.reliability.redundancy_numbers[0]).ravel(), 0.0, 1.0)
    counts, edges = np.histogram(r, np.linspace(0.0, 1.0, 21))
    ax.stairs(counts, edges, **styled(style, color=INTERNAL, fill=True))
    ax.set_xlabel("redundancy number")
    ax.set_ylabel("number")
    return ax


def iterations(result: Adjustment, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws v^T P v after each iteration, with damping and step, on a logarithmic scale. Else as for `redundancy`.

    Example:
        >>> ax = jb.plot.iterations(result)
        >>> ax.get_xlabel() != ""
        True
    """
    _, ax = begin(result, ax, "iterations")
    history = result.iterations.history
    rows = np.flatnonzero(~np.isnan(np.asarray(history.damping)))
    named = ("vTPv", 2 * np.asarray(history.cost)), ("lambda", history.damping), ("|J d| / |v|", history.step)
    for (name, values), line in zip(named, ("-", "--", ":"), strict=True):
        positive = np.asarray(values)[rows]
        ax.plot(rows + 1, np.where(positive > 0, positive, np.nan), line, marker=".", **styled(style, label=name))
    ax.set_yscale("log")
    ax.set_xlabel("iteration")
    ax.legend(fontsize="small")
    return ax


def doming(result: Adjustment, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draws the differences in height at control and check points over the distance from the centre of the block.

    With the fitted paraboloid dZ = a + b r^2: a bowl or a dome indicates distortion that the camera model does not
    contain.

    Raises: ValueError for fewer than three differences.

    Example:
        >>> ax = jb.plot.doming(result)
        >>> ax.get_ylabel() != ""
        True
    """
    figures, ax = begin(result, ax, "doming")
    found = dome(figures)
    if found is None:
        raise ValueError("doming needs differences in height at three control and check points or more")
    for mask, colour, name in ((~found.is_check, INTERNAL, "control"), (found.is_check, EXTERNAL, "check")):
        if mask.any():
            look = styled(style, marker="o", linestyle="none", color=colour, label=name)
            ax.plot(found.radius[mask], found.difference[mask], **look)
    r = np.linspace(0.0, float(found.radius.max()), 60)
    ax.plot(r, found.level + found.curvature * r**2, "k--", linewidth=1, label="paraboloid")
    unit = figures.structure.object_unit
    ax.set_xlabel(f"distance from the centre of the block [{unit}]")
    ax.set_ylabel(f"dZ [{unit}]")
    ax.set_title(f"curvature {found.curvature:.3g} (sd {found.sd:.2g}) per {unit}", fontsize="medium")
    ax.legend(fontsize="small")
    return ax
