"""The design matrix of a whole block, dense: residuals as a function of the corrections of all unknowns, by autodiff.

Observations are in the order of the tables of an adjustment, row by row: first the rays, then each group.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxbundle.block.residuals import Observations, weighted_residuals
from jaxbundle.block.unknowns import Correction, Unknowns, corrected

COLUMNS_AT_ONCE = 32
# maximum number of unknowns of a dense design matrix: with 10 000 observations it needs 240 MB, N needs 72 MB
MAX_UNKNOWNS = 3000


class Corrections(NamedTuple):
    """Corrections of all elements that may be unknown; angles are small angles relative to the current attitudes."""

    exterior: Float[Array, "6 image"]
    interior: Float[Array, "column camera"]
    parameters: Float[Array, " parameter"]
    points: Float[Array, "3 point"]


def free_masks(o: Observations) -> tuple[Array, ...]:
    """Masks of the free elements, in the shapes of `Corrections`."""
    return o.exterior_free, o.interior_free, o.parameter_free, o.point_free


def no_corrections(o: Observations) -> Corrections:
    """Corrections that are all 0."""
    return Corrections(*(jnp.zeros(mask.shape) for mask in free_masks(o)))


def after_corrections(unknowns: Unknowns, o: Observations, corrections: Corrections) -> Unknowns:
    """The unknowns after corrections; fixed elements may be corrected too."""
    interior = jnp.zeros_like(unknowns.interior).at[np.array(o.columns, int)].set(corrections.interior)
    correction = Correction(corrections.exterior, interior, corrections.parameters, corrections.points)
    return corrected(unknowns, correction, o.in_angles, o.system)


def residuals_after(unknowns: Unknowns, o: Observations) -> Callable[[Corrections], Float[Array, " observation"]]:
    """Residuals over their sigmas as a function of the corrections."""

    def residuals(corrections: Corrections) -> Float[Array, " observation"]:
        after = after_corrections(unknowns, o, corrections)
        return jnp.concatenate([v.T.ravel() for v in weighted_residuals(after, o)])

    return residuals


def elements(o: Observations) -> int:
    """Number of all elements that may be unknown."""
    return sum(mask.size for mask in free_masks(o))


class FreeElements(NamedTuple):
    """Indices of the free elements, in chunks padded with an index beyond the last one, and their number."""

    chunks: Int[np.ndarray, "chunk at_once"]
    number: int


def free_numbers(o: Observations) -> Int[np.ndarray, " free"]:
    """Indices of the free elements among all elements."""
    return np.flatnonzero(np.concatenate([np.ravel(mask) for mask in free_masks(o)]))


def free_elements(o: Observations) -> FreeElements:
    """The columns of the design matrix among all elements."""
    free = free_numbers(o)
    padded = np.full(-(-len(free) // COLUMNS_AT_ONCE) * COLUMNS_AT_ONCE, elements(o))
    padded[: len(free)] = free
    return FreeElements(padded.reshape(-1, COLUMNS_AT_ONCE), len(free))


def design_columns(
    unknowns: Unknowns, o: Observations, free: Int[Array, "chunk at_once"]
) -> Float[Array, "column observation"]:
    """Columns of A, 0 for an index beyond the last one."""
    zero, unflatten = ravel_pytree(no_corrections(o))
    residuals = residuals_after(unknowns, o)
    _, linear = jax.linearize(lambda correction: residuals(unflatten(correction)), zero)
    columns = jax.lax.map(jax.vmap(lambda k: linear(zero.at[k].set(1.0, mode="drop"))), free)
    return columns.reshape(free.size, -1)
