"""Inner orientation of scanned film: from scan px to mm in the system of the fiducials.

    conformal     x = a0 + a1 u + a2 v                            y = b0 + a2 u - a1 v
    affine        x = a0 + a1 u + a2 v                            y = b0 + b1 u + b2 v
    projective    x = (a0 + a1 u + a2 v) / (1 + c1 u + c2 v)      y = (b0 + b1 u + b2 v) / (1 + c1 u + c2 v)

u right, v down, x right, y up; therefore `conformal` includes a reflection, and a film scanned from its back needs
`affine`. Parameters minimise the sum of squares of v = (transformed - calibrated) in mm, all with weight 1 (Kraus
2007).

The fit is computed in q = (u - mean, v - mean) / rms distance, so that no digits are lost, and converted at the end.
It is computed once before the adjustment, in numpy.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.numerics.host import freeze_arrays

PARAMETERS = {
    "conformal": ("a0", "a1", "a2", "b0"),
    "affine": ("a0", "a1", "a2", "b0", "b1", "b2"),
    "projective": ("a0", "a1", "a2", "b0", "b1", "b2", "c1", "c2"),
}
NEWTON_STEPS = 20  # iterations: film is flat to 1e-3, so three are sufficient
CONVERGED = 1e-13  # share of the size of the image
# ratio of minimum and maximum singular value: 0.06 for corners and sides of film, 0.02 for a narrow strip;
DEGENERATE = 3e-3
# three fiducials on a line, straight to 0.02 mm, have 2e-4

Matrix = Float[np.ndarray, "3 3"]
Points = Float[np.ndarray, "point 2"]


class FiducialError(ValueError):
    """The error for fiducials that do not determine a transformation: `what` is wrong, and its `cure`.

    Example:
        >>> scan, calibrated = np.array([[10.0, 12.0]]), np.array([[-106.0, 106.0]])
        >>> try:
        ...     jb.cameras.inner_orientation("8811", "affine", ("1",), scan, calibrated)
        ... except jb.cameras.FiducialError as error:
        ...     print(error.what)
        image 8811 has 1 fiducial, too few for the affine transformation
    """

    def __init__(self, what: str, cure: str) -> None:
        super().__init__(f"{what}; {cure}")
        self.what, self.cure = what, cure


@dataclass(frozen=True, eq=False)
class InnerOrientation:
    """The fit of one image. `residuals`: transformed - calibrated, mm, in the order of `fiducials`.

    `matrix` takes (u, v, 1) in px to (x, y, 1) in mm times a factor; its last element is 1.

    Example:
        >>> scan = np.array([[0, 0], [4, 0], [4, 4], [0, 4.0]])
        >>> calibrated = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]])
        >>> fit = jb.cameras.inner_orientation("8811", "affine", ("1", "2", "3", "4"), scan, calibrated)
        >>> fit.transformation, bool(abs(fit.residuals).max() < 1e-9)
        ('affine', True)
    """

    image: str
    transformation: str
    matrix: Matrix
    fiducials: tuple[str, ...]
    residuals: Float[np.ndarray, "fiducial 2"]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters by name, as in the formulas of this module."""
        names = ("a0", "a1", "a2", "b0", "b1", "b2", "c1", "c2")
        values = dict(zip(names, self.matrix[[0, 0, 0, 1, 1, 1, 2, 2], [2, 0, 1, 2, 0, 1, 0, 1]].tolist(), strict=True))
        return {name: values[name] for name in PARAMETERS[self.transformation]}

    @property
    def redundancy(self) -> int:
        """Redundancy: observed coordinates minus parameters."""
        return self.residuals.size - len(PARAMETERS[self.transformation])

    @property
    def sigma0(self) -> float:
        """Standard deviation of a calibrated coordinate, mm; NaN without redundancy."""
        redundancy = self.redundancy
        return float(np.sqrt((self.residuals**2).sum() / redundancy)) if redundancy else float("nan")

    @property
    def worst(self) -> int:
        """Index of the fiducial with the longest residual."""
        return int(np.argmax(np.hypot(*self.residuals.T)))

    def to_mm(self, scan: Points) -> Points:
        """Transforms scan coordinates (px) to the system of the fiducials (mm)."""
        return transformed(self.matrix, scan)


def transformed(matrix: Float[np.ndarray, "*point 3 3"], points: Points) -> Points:
    """Transforms points by one matrix, or each by its own matrix."""
    x, y, w = np.moveaxis((matrix[..., :2] @ points[..., None])[..., 0] + matrix[..., 2], -1, 0)
    return np.stack([x / w, y / w], -1)


def fewest_fiducials(transformation: str) -> int:
    """The number of fiducials that determine the transformation without redundancy."""
    return len(PARAMETERS[transformation]) // 2


def inner_orientation(
    image: str, transformation: str, fiducials: tuple[str, ...], scan: Points, calibrated: Points
) -> InnerOrientation:
    """The transformation of one image from its measured fiducials (px) to the calibrated ones (mm).

    Raises: FiducialError if they are too few or do not determine it.

    Example:
        >>> scan = np.array([[0, 0], [4, 0], [4, 4], [0, 4.0]])
        >>> calibrated = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]])
        >>> fit = jb.cameras.inner_orientation("8811", "affine", ("1", "2", "3", "4"), scan, calibrated)
        >>> [round(float(x), 6) for x in fit.matrix @ [2.0, 2.0, 1.0]]
        [0.0, 0.0, 1.0]
    """
    few = fewest_fiducials(transformation)
    better = f"measure at least {few}, better {few + 1}"
    if len(fiducials) < few:
        count = f"{len(fiducials)} fiducial" + ("s" if len(fiducials) != 1 else "")
        raise FiducialError(f"image {image} has {count}, too few for the {transformation} transformation", better)
    q, of_scan = _reduced(scan)
    target, _ = _reduced(calibrated)
    if min(_determinacy(transformation, q), _determinacy(transformation, target)) < DEGENERATE:
        how = {"conformal": "at one position", "affine": "on a straight line"}.get(transformation, "three on one line")
        what = f"the fiducials of image {image} do not determine the {transformation} transformation: they lie {how}"
        raise FiducialError(what, "measure others, or correct their coordinates")
    if transformation == "projective":
        matrix = _projective(q, calibrated)
        if matrix is None:
            what = f"the projective transformation of the fiducials of image {image} does not converge"
            raise FiducialError(what, "correct their coordinates or names, or use the affine transformation")
    else:
        matrix = _linear(transformation, q, calibrated)
    matrix = matrix @ of_scan
    matrix = matrix / matrix[2, 2]
    return InnerOrientation(image, transformation, matrix, fiducials, transformed(matrix, scan) - calibrated)


class _Reduced(NamedTuple):
    """Points relative to their mean, in units of their root mean square distance, and the matrix of this reduction."""

    points: Points
    matrix: Matrix


def _reduced(points: Points) -> _Reduced:
    mean = points.mean(0)
    size = np.sqrt(((points - mean) ** 2).sum(1).mean()) or 1.0
    matrix = np.diag([1 / size, 1 / size, 1.0])
    matrix[:2, 2] = -mean / size
    return _Reduced((points - mean) / size, matrix)


def _design(transformation: str, q: Points) -> Float[np.ndarray, "row parameter"]:
    """Derivatives of all x, then of all y, with respect to the parameters of a linear transformation."""
    u, v = q.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    if transformation == "conformal":
        return np.r_[np.c_[one, u, v, zero], np.c_[zero, -v, u, one]]
    return np.r_[np.c_[one, u, v, zero, zero, zero], np.c_[zero, zero, zero, one, u, v]]


def _by_denominator(q: Points, at: Points) -> Float[np.ndarray, "row 2"]:
    """Derivatives of all x, then y, with respect to c1 and c2, times the denominator; `at`: transformed points."""
    return np.r_[-at[:, :1] * q, -at[:, 1:] * q]


def _determinacy(transformation: str, q: Points) -> float:
    """Ratio of minimum and maximum singular value of the equations, at the identity transformation."""
    design = _design(transformation, q)
    if transformation == "projective":
        design = np.c_[design, _by_denominator(q, q)]
    values = np.linalg.svd(design, compute_uv=False)
    return float(values[-1] / values[0])


def _linear(transformation: str, q: Points, calibrated: Points) -> Matrix:
    solution = np.linalg.lstsq(_design(transformation, q), calibrated.T.ravel(), rcond=None)[0]
    if transformation == "conformal":
        a0, a1, a2, b0 = solution
        solution = np.array([a0, a1, a2, b0, a2, -a1])
    a0, a1, a2, b0, b1, b2 = solution
    return np.array([[a1, a2, a0], [b1, b2, b0], [0.0, 0.0, 1.0]])


def _projective(q: Points, calibrated: Points) -> Matrix | None:
    """Gauss-Newton from the affine transformation; None if it does not converge."""
    matrix = _linear("affine", q, calibrated)
    linear, size = _design("affine", q), np.abs(calibrated).max()
    for _ in range(NEWTON_STEPS):
        denominator = 1 + q @ matrix[2, :2]
        if (denominator <= 0).any():  # the horizon of the transformation lies between the fiducials
            return None
        at = transformed(matrix, q)
        design = np.c_[linear, _by_denominator(q, at)] / np.tile(denominator, 2)[:, None]
        step = np.linalg.lstsq(design, (calibrated - at).T.ravel(), rcond=None)[0]
        a0, a1, a2, b0, b1, b2, c1, c2 = step
        matrix = matrix + np.array([[a1, a2, a0], [b1, b2, b0], [c1, c2, 0.0]])
        if np.abs(design @ step).max() <= CONVERGED * size:
            return matrix
    return None
