"""Types of least-squares matching: how windows are matched, what comes out, why a match is refused."""

from enum import IntEnum
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

MIN_CORRELATION = 0.8  # refused in practice below 0.7 to 0.85
MAX_SIGMA = 0.2  # px: a point that is less precise than this was found better by its detector
SCALE = 0.5, 2.0  # of the window: beyond, the images show different details
SETTLED = 0.003  # px: last step of the shift; a tenth of the precision of a good match
MAX_ITERATIONS = 20  # a match that needs more does not come to its end
SIGNIFICANT = 3.0  # standard deviations


class Refusal(IntEnum):
    """Why a match is refused; MATCHED where it is not.

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
    Refusal.OUTSIDE: "the window leaves the part of the image that is searched",
    Refusal.SCALE: "the scale of the window is implausible",
    Refusal.LOW_CORRELATION: "the windows are too unlike",
    Refusal.IMPRECISE: "the position is not precise enough",
    Refusal.NO_WINDOW: "the point lies too near to the border of an image",
}

Parameters = Literal["shift", "affine", "tested"]


class MatchOptions(NamedTuple):
    """How windows are matched.

    Example:
        >>> jb.imagery.MatchOptions(parameters="affine").max_iterations
        20
    """

    parameters: Parameters = "tested"
    """"shift": position and radiometry; "affine": six affine parameters and radiometry; "tested": affine only where
    a parameter differs significantly from its start."""
    interpolation: Literal["spline", "bilinear"] = "spline"
    """Of the searched image; bilinear as a control only."""
    max_iterations: int = MAX_ITERATIONS
    settled: float = SETTLED
    """px: largest last step of the position."""
    min_correlation: float = MIN_CORRELATION
    max_sigma: float = MAX_SIGMA
    """px: largest standard deviation of a coordinate."""
    max_shift: float | None = None
    """px: largest distance from the start; a quarter of the window if it is not given."""


DEFAULT = MatchOptions()


class Matches(eqx.Module):
    """Windows matched in other images; one row per match. Lengths in px.

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
    """r0, r1 of template = r0 + r1 searched."""
    covariance: Float[Array, "*match 2 2"]
    """Of the position, from the residuals of the grey values."""
    sigma0: Float[Array, "*match"]
    """Standard deviation of the residuals, in grey values."""
    correlation: Float[Array, "*match"]
    """Of template and matched window."""
    iterations: Int[Array, "*match"]
    status: Int[Array, "*match"]
    """A `Refusal` as number."""

    @property
    def matched(self) -> Bool[np.ndarray, "*match"]:
        """Which matches are accepted (concrete results only)."""
        return np.asarray(self.status) == Refusal.MATCHED

    @property
    def sigmas(self) -> Float[Array, "*match 2"]:
        """Standard deviations of the position."""
        return self.covariance[..., (0, 1), (0, 1)] ** 0.5
