"""Types of least-squares matching: options, results, and reasons of refusal."""

from enum import IntEnum
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

MIN_CORRELATION = 0.8  # in practice the limit is 0.7 to 0.85
MAX_SIGMA = 0.2  # px: for less precise points the detector is better
SCALE = 0.5, 2.0  # scale of the window: outside, the images show different details
SETTLED = 0.003  # px: last step of the shift; a tenth of the precision of a good match
MAX_ITERATIONS = 20  # maximum number: a match that needs more does not converge
SIGNIFICANT = 3.0  # limit in standard deviations


class Refusal(IntEnum):
    """Reason of the refusal of a match; MATCHED for an accepted one.

    Example:
        >>> jb.imagery.Refusal(0).name
        'MATCHED'
    """

    MATCHED = 0
    NO_TEXTURE = 1
    NOT_CONVERGED = 2
    MOVED_FAR = 3
    OUTSIDE = 4
    SCALE = 5
    LOW_CORRELATION = 6
    IMPRECISE = 7
    NO_WINDOW = 8

    @property
    def words(self) -> str:
        """The reason in a sentence."""
        return _WORDS[self]


_WORDS = {
    Refusal.MATCHED: "matched",
    Refusal.NO_TEXTURE: "the window has no texture that determines a position",
    Refusal.NOT_CONVERGED: "the iteration does not converge",
    Refusal.MOVED_FAR: "the match lies too far from its predicted position",
    Refusal.OUTSIDE: "the window leaves the searched part of the image",
    Refusal.SCALE: "the scale of the window is implausible",
    Refusal.LOW_CORRELATION: "the windows are too different",
    Refusal.IMPRECISE: "the position is not precise enough",
    Refusal.NO_WINDOW: "the point lies too near to the border of an image",
}

Parameters = Literal["shift", "affine", "tested"]


class MatchOptions(NamedTuple):
    """Options of least-squares matching.

    Example:
        >>> jb.imagery.MatchOptions(parameters="affine").max_iterations
        20
    """

    parameters: Parameters = "tested"
    """"shift": position and radiometry; "affine": six affine parameters and radiometry; "tested": affine only if a
    parameter differs significantly from its start."""
    interpolation: Literal["spline", "bilinear"] = "spline"
    """Interpolation of the searched image; bilinear only for comparison."""
    max_iterations: int = MAX_ITERATIONS
    settled: float = SETTLED
    """px: maximum last step of the position."""
    min_correlation: float = MIN_CORRELATION
    max_sigma: float = MAX_SIGMA
    """px: maximum standard deviation of a coordinate."""
    max_shift: float | None = None
    """px: maximum distance from the start; by default a quarter of the window."""


DEFAULT = MatchOptions()


class Matches(eqx.Module):
    """Results of matching windows in other images; one row per match. Lengths in px.

    Example:
        >>> start = [[17.5, 1, 0, 17.5, 0, 1]]
        >>> found = jb.imagery.match(texture[None, 12:23, 12:23], texture[None], [[5.5, 5.5]], start)
        >>> found.position.shape, found.covariance.shape
        ((1, 2), (1, 2, 2))
    """

    position: Float[Array, "*match 2"]
    """x, y of the reference point in the searched window."""
    affine: Float[Array, "*match 2 2"]
    """Derivatives of x and y in the searched image with respect to x and y in the template."""
    radiometry: Float[Array, "*match 2"]
    """Radiometric parameters r0, r1 of template = r0 + r1 searched."""
    covariance: Float[Array, "*match 2 2"]
    """Covariance of the position, from the residuals of the grey values."""
    sigma0: Float[Array, "*match"]
    """Standard deviation of the residuals, in grey values."""
    correlation: Float[Array, "*match"]
    """Correlation of template and matched window."""
    iterations: Int[Array, "*match"]
    status: Int[Array, "*match"]
    """A `Refusal` as a number."""

    @property
    def matched(self) -> Bool[np.ndarray, "*match"]:
        """Mask of the accepted matches (concrete results only)."""
        return np.asarray(self.status) == Refusal.MATCHED

    @property
    def sigmas(self) -> Float[Array, "*match 2"]:
        """Standard deviations of the position."""
        return self.covariance[..., (0, 1), (0, 1)] ** 0.5
