"""Points, images, residual vectors and error ellipses of a block or an adjustment, in its object system."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.numerics.host import on_host
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.covariance import error_ellipses
from jaxbundle.statistics.reliability_tables import reliability

SHARE = 0.03  # share of the extent of the block: length of the median residual vector and ellipse in a drawing


class Vectors(NamedTuple):
    """Residuals of control and check points, adjusted - known, with the names of the points."""

    names: tuple[str, ...]
    start: Float[np.ndarray, "vector 3"]
    residual: Float[np.ndarray, "vector 3"]


class Ellipses(NamedTuple):
    """Standard error ellipses in the plane: semi-axes, and the direction of the larger one, radians from X to Y."""

    axes: Float[np.ndarray, "point 2"]
    direction: Float[np.ndarray, " point"]


class Features(NamedTuple):
    """All objects to draw. `sigmas` and `ellipses` are None without an adjustment with standard deviations."""

    block: Block
    points: Float[np.ndarray, "point 3"]
    sigmas: Float[np.ndarray, "point 3"] | None
    rays: Int[np.ndarray, " point"]
    role: Int[np.ndarray, " point"]
    """0 tie, 1 control, 2 check point."""
    largest: Float[np.ndarray, " point"] | None
    """The largest |w| / sigma0 of the rays, of |v| / (sigma0 sigma) where there is no w; None without an adjustment."""
    centres: Float[np.ndarray, "image 3"]
    angles: Float[np.ndarray, "image 3"]
    """In radians, in the rotation system of the block."""
    vectors: Vectors
    ellipses: Ellipses | None

    @property
    def extent(self) -> float:
        """Diagonal of the extent of the points in the plane."""
        plane = self.points[:, :2]
        return float(np.linalg.norm(np.ptp(plane, axis=0))) if len(plane) else 1.0

    @property
    def vector_scale(self) -> float:
        """Factor that enlarges residual vectors in a drawing: a power of ten."""
        return _stretch(np.linalg.norm(self.vectors.residual[:, :2], axis=1), self.extent)

    @property
    def ellipse_scale(self) -> float:
        """Factor that enlarges error ellipses in a drawing: a power of ten."""
        return 1.0 if self.ellipses is None else _stretch(self.ellipses.axes[:, 0], self.extent)


def _stretch(lengths: Float[np.ndarray, " length"], extent: float) -> float:
    lengths = lengths[lengths > 0]
    if not len(lengths) or not extent > 0:
        return 1.0
    return float(10.0 ** math.floor(math.log10(SHARE * extent / float(np.median(lengths)))))


def features_of(result: Block | Adjustment) -> Features:
    """The features of an adjustment or a block."""
    block = result.block if isinstance(result, Adjustment) else result
    s, points = block.structure, on_host(block.object_points)
    sigmas, ellipses = None, None
    if isinstance(result, Adjustment) and result.cofactors is not None:
        sigmas, ellipses = on_host(result.standard_deviations.object_points), _ellipses(result)
    return Features(
        block,
        points,
        sigmas,
        np.bincount(s.ray_point, minlength=len(points)),
        _roles(block),
        _largest(result) if isinstance(result, Adjustment) else None,
        on_host(block.exterior.projection_centre),
        on_host(block.exterior.angles),
        _vectors(block, points),
        ellipses,
    )


def _roles(block: Block) -> Int[np.ndarray, " point"]:
    s = block.structure
    role = np.where(s.point_free.all(1), 0, 1)
    for group in block.groups:
        if group.structure.kind == CONTROL:
            role[group.structure.indices[:, 0]] = 1
    role[s.check_point] = 2
    return role


def _largest(result: Adjustment) -> Float[np.ndarray, " point"]:
    s, largest = result.block.structure, np.zeros(len(result.block.structure.point_names))
    numbers = result.weighted_residuals[0] if result.redundancy_numbers is None else reliability(result).w[0]
    with np.errstate(all="ignore"):
        size = np.nan_to_num(np.abs(on_host(numbers)) / float(result.sigma0), nan=0.0, posinf=0.0)
    np.maximum.at(largest, s.ray_point, size.max(1, initial=0.0))
    return largest


def _vectors(block: Block, points: Float[np.ndarray, "point 3"]) -> Vectors:
    """Adjusted - known of points with a known coordinate; an unknown coordinate has the residual 0."""
    s = block.structure
    rows = [(int(k), place) for k, place in zip(s.check_point, on_host(block.check_points.coordinates), strict=True)]
    for group in (group for group in block.groups if group.structure.kind == CONTROL):
        known = np.where(group.structure.observed, on_host(group.values), np.nan)
        rows += [(int(k), place) for k, place in zip(group.structure.indices[:, 0], known, strict=True)]
    index = np.array([k for k, _ in rows], np.int64)
    known = np.array([place for _, place in rows], float).reshape(-1, 3)
    residual = np.nan_to_num(points[index] - known) if len(index) else known
    return Vectors(tuple(s.point_names[k] for k in index), points[index], residual)


def _ellipses(adjustment: Adjustment) -> Ellipses:
    found = error_ellipses(adjustment)
    axes, directions = on_host(found.semi_axes), on_host(found.directions)
    return Ellipses(axes, np.arctan2(directions[:, 1, 0], directions[:, 0, 0]))
