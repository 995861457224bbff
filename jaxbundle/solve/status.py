"""How the iterations of an adjustment ended."""

from enum import IntEnum

import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Int


class Status(IntEnum):
    """How the iterations ended."""

    MAXIMUM_ITERATIONS = 0
    CONVERGED = 1
    SINGULAR = 2
    DIVERGED = 3
    STALLED = 4
    INTERRUPTED = 5
    CREEPING = 6

    @property
    def words(self) -> str:
        """The status as a sentence's end."""
        return {
            Status.CONVERGED: "converged",
            Status.MAXIMUM_ITERATIONS: "ended at the maximum number of iterations, not converged",
            Status.SINGULAR: "ended at a singular normal matrix, not converged",
            Status.DIVERGED: "diverged",
            Status.STALLED: "ended where no step reduces the residuals any more, not converged",
            Status.CREEPING: (
                "ended where unknowns that are hardly determined still move and the residuals no longer change,"
                " not converged"
            ),
            Status.INTERRUPTED: "was interrupted, not converged: the last accepted unknowns are kept",
        }[self]


# INTERRUPTED and CREEPING are decided between two steps, outside of the solver
OF_RESULTS = (
    (optx.RESULTS.successful, Status.CONVERGED),
    (optx.RESULTS.nonlinear_max_steps_reached, Status.MAXIMUM_ITERATIONS),
    (optx.RESULTS.singular, Status.SINGULAR),
    (optx.RESULTS.stagnation, Status.STALLED),
)


def status_of(result: optx.RESULTS) -> Int[Array, ""]:
    """The status by the result of a solve with optimistix; whatever else went wrong there has diverged."""
    status = jnp.asarray(int(Status.DIVERGED))
    for known, number in OF_RESULTS:
        status = jnp.where(result == known, int(number), status)
    return status
