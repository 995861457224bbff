"""Trying an adjustment that may fail without an error of the user."""

from typing import Unpack

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.options import Choices


def attempt(block: Block, **choices: Unpack[Choices]) -> Adjustment | None:
    """The adjustment without standard deviations; None if the block cannot be adjusted or does not converge."""
    wanted: Choices = {**choices, "precision": False}
    try:
        found = adjust(block, **wanted)
    except BlockError:
        return None
    return found if found.status is Status.CONVERGED else None
