"""An adjustment that is tried, as a question to a block: it may fail without being an error of the user."""

from typing import Any

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status


def attempt(block: Block, **options: Any) -> Adjustment | None:
    """The adjustment without standard deviations; None where the block cannot be adjusted or does not converge."""
    try:
        found = adjust(block, precision=False, **options)
    except BlockError:
        return None
    return found if found.status is Status.CONVERGED else None
