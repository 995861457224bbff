"""Residuals as a function of the corrections of all unknowns: what the design matrix, whole or transposed, is made of.

Observations follow the tables of an adjustment, row by row: the rays first, then every group.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.residuals import Observations, weighted_residuals
from jaxbundle.block.unknowns import Correction, Unknowns, corrected


class Corrections(NamedTuple):
    """Corrections of everything that may be unknown; angles are small ones about the attitudes reached."""

    exterior: Float[Array, "6 image"]
    interior: Float[Array, "column camera"]
    parameters: Float[Array, " parameter"]
    points: Float[Array, "3 point"]


def free_masks(o: Observations) -> tuple[Array, ...]:
    """Which elements are free, in the shapes of `Corrections`."""
    return o.exterior_free, o.interior_free, o.parameter_free, o.point_free


def no_corrections(o: Observations) -> Corrections:
    """Zeros."""
    return Corrections(*(jnp.zeros(mask.shape) for mask in free_masks(o)))


def residuals_after(unknowns: Unknowns, o: Observations) -> Callable[[Corrections], Float[Array, " observation"]]:
    """Residuals over their sigmas as a function of the corrections; what is held may be corrected too."""

    def residuals(corrections: Corrections) -> Float[Array, " observation"]:
        interior = jnp.zeros_like(unknowns.interior).at[np.array(o.columns, int)].set(corrections.interior)
        correction = Correction(corrections.exterior, interior, corrections.parameters, corrections.points)
        moved = corrected(unknowns, correction, o.in_angles, o.system)
        return jnp.concatenate([v.T.ravel() for v in weighted_residuals(moved, o)])

    return residuals
