"""What of an array can be drawn: finite numbers of a usable size."""

import numpy as np
from jaxtyping import Float

LARGEST = 1e15  # beyond, differences of coordinates have no digit left in double precision


def known(values: np.ndarray) -> Float[np.ndarray, "..."]:
    """The values as floating-point numbers, NaN in place of what cannot be drawn."""
    values = np.asarray(values, float)
    return np.where(np.abs(values) < LARGEST, values, np.nan)  # NaN is not smaller than anything


def limits(values: np.ndarray, share: float = 0.04) -> tuple[float, float]:
    """The smallest and the largest known value with a margin of that share; 0 and 1 where nothing is known."""
    values = known(values)
    if not np.isfinite(values).any():
        return 0.0, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = share * (high - low) or max(abs(high) * 1e-6, 0.5)
    return low - margin, high + margin


def root_mean_square(values: np.ndarray) -> float:
    """Root mean square of the known values; NaN without any."""
    values = known(values)
    count = int(np.isfinite(values).sum())
    return float(np.sqrt(np.nansum(values**2) / count)) if count else float("nan")


def nice(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not longer; 1 for what has no length."""
    if not (np.isfinite(length) and length > 0):
        return 1.0
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-12)))
