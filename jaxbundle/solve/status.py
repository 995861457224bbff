"""The status of an adjustment: the end of its iterations."""

from enum import IntEnum
from typing import Any

import optimistix as optx

from jaxbundle.numerics.host import on_host_or_traced


class Status(IntEnum):
    """Status of the iterations at their end.

    Example:
        >>> result.status is jb.Status.CONVERGED
        True
    """

    MAXIMUM_ITERATIONS = 0
    CONVERGED = 1
    SINGULAR = 2
    DIVERGED = 3
    STALLED = 4
    INTERRUPTED = 5
    CREEPING = 6

    @property
    def words(self) -> str:
        """The status as the end of a sentence."""
        return {
            Status.CONVERGED: "converged",
            Status.MAXIMUM_ITERATIONS: "stopped at the maximum number of iterations (not converged)",
            Status.SINGULAR: "stopped at a singular normal matrix (not converged)",
            Status.DIVERGED: "diverged",
            Status.STALLED: "stopped because no step reduces the residuals further (not converged)",
            Status.CREEPING: (
                "stopped because only hardly determined unknowns still change, without an effect on the residuals"
                " (not converged)"
            ),
            Status.INTERRUPTED: "was interrupted (not converged) and has the last accepted unknowns",
        }[self]


# INTERRUPTED and CREEPING are decided between two steps, outside the solver
OF_RESULTS = (
    (optx.RESULTS.successful, Status.CONVERGED),
    (optx.RESULTS.nonlinear_max_steps_reached, Status.MAXIMUM_ITERATIONS),
    (optx.RESULTS.singular, Status.SINGULAR),
    (optx.RESULTS.stagnation, Status.STALLED),
)


@on_host_or_traced
def status_of(xp: Any, result: optx.RESULTS) -> Any:
    """The status for a result of optimistix; any other failure means "diverged"."""
    status = xp.asarray(int(Status.DIVERGED))
    for known, number in OF_RESULTS:
        status = xp.where(result == known, int(number), status)
    return status
