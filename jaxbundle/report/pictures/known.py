"""Values of an array that can be drawn: finite numbers of a usable size."""

import numpy as np
from jaxtyping import Float

LARGEST = 1e15  # above this, differences of coordinates have no correct digit in double precision


def known(values: np.ndarray) -> Float[np.ndarray, "..."]:
    """The values as floating-point numbers, NaN for values that cannot be drawn."""
    values = np.asarray(values, float)
    return np.where(np.abs(values) < LARGEST, values, np.nan)  # NaN is not smaller than anything


def limits(values: np.ndarray, share: float = 0.04) -> tuple[float, float]:
    """Minimum and maximum of the known values with a margin; 0 and 1 where no value is known."""
    values = known(values)
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = share * (high - low) or max(abs(high) * 1e-6, 0.5)
    return low - margin, high + margin


def root_mean_square(values: np.ndarray) -> float:
    """Root mean square of the known values; NaN without known values."""
    values = known(values)
    count = int(np.isfinite(values).sum())
    return float(np.sqrt(np.nansum(values**2) / count)) if count else float("nan")


def nice(length: float) -> float:
    """The maximum round length (1, 2 or 5 times a power of ten) up to a given length; 1 for a length of 0."""
    if not (np.isfinite(length) and length > 0):
        return 1.0
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-12)))
