"""Joint significance of estimated elements: which of them do not differ from 0.

Each of several correlated elements may be smaller than its standard deviation, although together they are significant.
So they are fixed at 0 one after the other, the least significant first. Fixing x_a = 0 changes the others and their
covariance,

    x_b' = x_b - C_ba / C_aa x_a,        C_bb' = C_bb - C_ba C_ab / C_aa        (conditional expectation)

and the next one is tested with these values, until all remaining ones are significant (backward elimination; Draper and
Smith 1998, ch. 15).
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.solve.adjustment import Adjustment

SIGNIFICANT = 2.0  # standard deviations: 5 % of elements that are truly 0 exceed it
WITHOUT_ZERO = (
    "directions",
    "scale_bars",
    "planes",
    "lines",
)  # kinds with parameters for which 0 is not a special value
NEVER_ZERO = (
    "principal_distance",
    "x0",
    "y0",
    "pixel_size",
    "y_axis",
)  # elements of a camera for which 0 is not a special value


def insignificant(
    values: Float[np.ndarray, " element"], covariance: Float[np.ndarray, "element element"]
) -> tuple[list[int], Float[np.ndarray, " element"]]:
    """Elements that may be fixed at 0, in the order of the tests, and |value| / sd of each at its test."""
    x, c = np.array(values, float), np.array(covariance, float)
    left, held = list(range(len(x))), []
    ratios = np.full(len(x), np.inf)
    while left:
        sd = np.sqrt(np.maximum(np.diagonal(c)[left], 0.0))
        ratio = np.where(sd > 0, np.abs(x[left]) / np.where(sd > 0, sd, 1.0), np.inf)
        ratios[left] = ratio
        weakest = int(np.argmin(ratio))
        if not ratio[weakest] < SIGNIFICANT:
            break
        a = left.pop(weakest)
        held.append(a)
        gain = c[:, a] / c[a, a]
        x, c = x - gain * x[a], c - np.outer(gain, c[a])
    return held, ratios


def tested_parameters(adjustment: Adjustment) -> Bool[np.ndarray, " parameter"]:
    """Mask of unknown parameters for which 0 is a special value and a standard deviation is known."""
    structure, tested = adjustment.block.structure, adjustment.block.structure.parameter_free
    if adjustment.cofactors is None:
        return np.zeros_like(tested)
    for group in adjustment.block.groups:
        if group.structure.kind.name in WITHOUT_ZERO:
            touched = [k for k, kind in enumerate(group.structure.kind.touches) if kind == "parameter"]
            tested[group.structure.indices[:, touched].ravel()] = False
    variance = np.diagonal(np.asarray(adjustment.cofactors.parameters)).reshape(len(structure.parameters))
    return tested & (variance > 0)


def parameter_ratios(adjustment: Adjustment) -> Float[np.ndarray, " parameter"]:
    """Ratio |value| / sd of each parameter; NaN where it has no meaning: fixed, undetermined, or 0 not special."""
    tested = tested_parameters(adjustment)
    if not tested.any():
        return np.full(len(tested), np.nan)
    sd = np.asarray(adjustment.standard_deviations.parameters)
    return np.where(tested, np.abs(np.asarray(adjustment.block.parameters)) / np.where(tested, sd, 1.0), np.nan)
