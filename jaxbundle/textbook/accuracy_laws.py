"""Accumulation of errors along a strip of n stereopairs, and the distance between control points.

    m_Xn = m_x sqrt(1^2 + 2^2 + ... + n^2) = m_x sqrt((2 n^3 + 3 n^2 + n) / 6)                                   (167)
    0.58 n^1.5, the printed approximation, is too small by 12.6 % at n = 5, by 6.5 % at 10, by 3.2 % at 20
    (168) (n + 1/2)^1.5 / sqrt(3) is within 0.42 % from n = 5 on
    free end:          m_C = k_C m m_q n^1.5,    k = 1.1, 0.57, 0.93 f/b in X, Y, Z                        (169), (228)
    tied, in the middle:  n/2 instead of n, the result divided by sqrt(2): a quarter of the free end              (229)

m is the scale number, m_q the standard deviation of a parallax, f the principal distance, b the photo base; the strip
is flown along X. The numbers in brackets are equations of Text 000 and of Text 004 (228, 229).

Two points are important for a comparison with a bundle adjustment. (1) m_q: read as the standard deviation
of one image coordinate, the printed constants agree with a bundle of 60 % overlap within 31 %; read as a parallax, the
difference of two coordinates and sqrt(2) times as large, they are up to 1.9 times pessimistic. (2) "Tied": with a
random walk of the curvature a strip behaves like a beam. Hinged ends, which fix only the position, reduce the variance
L^3/3 of the free end to L^3/48 in the middle: a quarter of the standard deviation. Clamped ends, which also fix scale
and azimuth, reduce it to L^3/192: an eighth. Two XYZ points across each end clamp X and Y, but only hinge Z.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

QUARTER, EIGHTH = (3 / 48) ** 0.5, (3 / 192) ** 0.5  # ratio of middle and free end of a hinged and of a clamped beam
ENDS = {
    "hinged": (QUARTER, QUARTER, QUARTER),
    "clamped": (EIGHTH, EIGHTH, QUARTER),
}
"""Ratio of the middle of a tied strip to a free end in X, Y, Z: ends with single points, or with pairs of points."""
BLOCK_FACTORS = 1.5, 2.0  # printed factor for larger distances of control in a block


class StripLaw(NamedTuple):
    """Constants k of a law: m_X = X m m_q n^1.5, m_Y = Y m m_q n^1.5, m_Z = Z (f/b) m m_q n^1.5."""

    X: float
    Y: float
    Z: float


PRINTED = StripLaw(1.1, 0.57, 0.93)
"""(169) = (228)."""
BUNDLE = StripLaw(1.00, 0.82, 1.00)
"""A bundle adjustment at 60 % overlap, m_q read as the standard deviation of one image coordinate: the limit of long
strips, approached from below (leading coefficients of `FREE_END_VARIANCES`)."""

# Variance of the free end in (sigma0 m)^2 as a cubic in n: coefficients of n^3, n^2, n. Fitted to the covariance of
# schematic strips of n = 5 ... 60 bases; the standard deviations agree within 0.1 % at 60 % and 0.5 % at 80 % overlap.
# f/b is 153/92 at 60 % and 153/46 at 80 %. The leading term of Z at 60 % is (f/b)^2.
FREE_END_VARIANCES = {
    60: ((1.000, -3.33, 3.66), (0.665, -2.85, 5.37), (2.764, -4.55, 6.11)),
    80: ((0.0490, -0.148, 0.40), (0.0318, -0.124, 0.77), (0.0975, 0.320, 1.74)),
}


class StripSetup(NamedTuple):
    """Parameters of a strip for the laws."""

    scale_number: float
    """m."""
    parallax_error: float
    """Parallax error m_q; its unit is the unit of all results."""
    principal_distance: float
    """Principal distance f, any unit."""
    base: float
    """Base b at photo scale, in the unit of f."""


class Spacing(NamedTuple):
    """Distance between control for a tolerance in the middle of the strip."""

    pairs_by_coordinate: Float[np.ndarray, "3"]
    """Number of stereopairs n_c for each coordinate."""
    pairs: int
    """The minimum n of them, rounded down."""
    distance: float
    """Distance D = n b m, in the unit of b."""
    predicted: Float[np.ndarray, "3"]
    """Standard deviations in the middle with n stereopairs, in the unit of m_q."""


def accumulation(pairs: float | np.ndarray) -> float | np.ndarray:
    """The exact growth sqrt(1^2 + 2^2 + ... + n^2) of errors over n stereopairs.

    Args:
        pairs: n, number of stereopairs.

    Returns: m_Xn / m_x, without unit.

    Example: `accumulation(10)` is 19.62; the printed 0.58 n^1.5 gives 18.34.
    """
    n = np.asarray(pairs, float)
    return np.sqrt((2 * n**3 + 3 * n**2 + n) / 6)[()]


def printed_accumulation(pairs: float | np.ndarray) -> float | np.ndarray:
    """The printed approximation 0.58 n^1.5 of the growth; too small by 6.5 % at n = 10."""
    return 0.58 * np.asarray(pairs, float)[()] ** 1.5


def close_accumulation(pairs: float | np.ndarray) -> float | np.ndarray:
    """The approximation (n + 1/2)^1.5 / sqrt(3) of the growth; within 0.42 % from n = 5 on."""
    return (np.asarray(pairs, float)[()] + 0.5) ** 1.5 / np.sqrt(3)


def random_walk_middle(pairs: int) -> float:
    """Standard deviation in the middle of a random walk of directions tied at both ends, over m_x.

    The variance is n (n^2 + 2) / 48 for even n: the exact sum behind the rule "n/2 and sqrt(2)".

    Raises: ValueError for an odd number of pairs.
    """
    if pairs % 2:
        raise ValueError(f"{pairs} stereopairs have no point in the middle; give an even number")
    return float(np.sqrt(pairs * (pairs**2 + 2) / 48))


def free_end(pairs: float, setup: StripSetup, law: StripLaw = PRINTED) -> Float[np.ndarray, "3"]:
    """Standard deviations of X, Y, Z at the free end of a strip, by (169).

    Args:
        pairs: n, number of stereopairs from the control at the beginning.
        setup: scale number, parallax error, principal distance and base.
        law: the constants, PRINTED or BUNDLE.

    Returns: standard deviations in the unit of the parallax error, in object space.

    Example: `free_end(10, StripSetup(1.0, 0.01, 70, 70))` is 0.348, 0.180, 0.294 mm at photo scale.
    """
    return _constants(setup, law) * pairs**1.5


def tied_middle(
    pairs: float, setup: StripSetup, law: StripLaw = PRINTED, ends: str = "hinged"
) -> Float[np.ndarray, "3"]:
    """Standard deviations in the middle of a strip between control at both ends, by (229).

    Args:
        pairs: n, number of stereopairs between the ends.
        setup: scale number, parallax error, principal distance and base.
        law: the constants, PRINTED or BUNDLE.
        ends: "hinged", the printed rule, or "clamped", two XYZ points across each end (`ENDS`).

    Returns: standard deviations in the unit of the parallax error. The printed example, 0.08, 0.05, 0.08 mm for ten
    stereopairs, is reproduced in Y only: 0.087, 0.045, 0.0735 mm.

    Raises: ValueError for unknown ends.
    """
    if ends not in ENDS:
        raise ValueError(f"ends {ends!r} are unknown; there are {', '.join(ENDS)}")
    return free_end(pairs, setup, law) * ENDS[ends]


def bundle_free_end(bases: int, overlap: int = 60) -> Float[np.ndarray, "3"]:
    """Standard deviations of a bundle's free end in sigma0 times m, from the cubic in n.

    Args:
        bases: n, number of bases, 5 to 60.
        overlap: forward overlap in percent, 60 or 80; the bases are those of this overlap.

    Returns: standard deviations of X, Y, Z in units of sigma0 m, for f/b = 153/92 (60 %) or 153/46 (80 %).

    Raises: ValueError for another overlap.
    """
    if overlap not in FREE_END_VARIANCES:
        raise ValueError(f"no cubic for {overlap} % overlap; there are {', '.join(map(str, FREE_END_VARIANCES))} %")
    powers = np.array([bases**3, bases**2, bases], float)
    return np.sqrt(np.array(FREE_END_VARIANCES[overlap]) @ powers)


def spacing(
    tolerance: Float[np.ndarray, "3"] | tuple[float, float, float], setup: StripSetup, law: StripLaw = PRINTED
) -> Spacing:
    """Number of stereopairs and distance between control for a tolerance, the inverse of (229).

    n_c = (4 T_c / (k_c m m_q))^(2/3), n the smallest n_c rounded down, D = n b m.

    Args:
        tolerance: maximum allowed standard deviations of X, Y, Z in the middle, in the unit of the parallax error.
        setup: scale number, parallax error, principal distance and base.
        law: the constants, PRINTED or BUNDLE.

    Raises: ValueError for tolerances that are not positive, or that one stereopair already exceeds.

    Example: `spacing((800, 500, 800), StripSetup(10000, 0.01, 70, 70))`, in mm, gives 9 pairs and 6.3e6 mm.
    """
    wanted = np.asarray(tolerance, float)
    if not (wanted > 0).all():
        raise ValueError(f"tolerances are {wanted.tolist()}; give positive ones")
    pairs = (wanted / (QUARTER * _constants(setup, law))) ** (2 / 3)
    n = int(np.floor(pairs.min() + 1e-9))
    if n < 1:
        what = "XYZ"[int(np.argmin(pairs))]
        raise ValueError(f"the tolerance of {what} allows {pairs.min():.2f} stereopairs; allow more, or fly lower")
    return Spacing(pairs, n, n * setup.base * setup.scale_number, tied_middle(n, setup, law))


def block_factor(strips: int) -> float:
    """Factor for the distance of control in S laterally tied strips with control at each strip end: S^(1/3).

    The printed rule for blocks is 1.5 to 2: the factor of 4 to 8 strips.
    """
    if strips < 1:
        raise ValueError(f"{strips} strips; give 1 or more")
    return float(strips ** (1 / 3))


def _constants(setup: StripSetup, law: StripLaw) -> Float[np.ndarray, "3"]:
    """k_c m m_q."""
    for name, value in zip(setup._fields, setup, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name.replace('_', ' ')} is {value}; give a positive number")
    ratio = setup.principal_distance / setup.base
    return np.array([law.X, law.Y, law.Z * ratio]) * setup.scale_number * setup.parallax_error
