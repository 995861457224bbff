"""The start of models and strips: orientations as given, or found from the rays."""

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.unknowns import without_orientation
from jaxbundle.orientation.from_nothing import approximate
from jaxbundle.orientation.intersection import intersect
from jaxbundle.orientation.start_findings import found_orientations


def started(block: Block) -> tuple[Block, list[Finding]]:
    """The block with an orientation for every image and coordinates for every point, and what was found.

    Raises: BlockError for images that cannot be oriented.
    """
    if not without_orientation(block).any():
        return intersect(block), []
    found = approximate(block)
    problems = [
        Problem(
            f"image {found.block.structure.image_names[k]} has no orientation, and its rays do not give one",
            "measure at least 8 points on it that other images show, or give it approximate values",
            "images",
            int(k),
        )
        for k in np.flatnonzero(without_orientation(found.block))
    ]
    if problems:
        raise BlockError(problems)
    return found.block, [*found.findings, *found_orientations(found)]
