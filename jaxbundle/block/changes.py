"""Changes of what is unknown in a block."""

import dataclasses

import numpy as np

from jaxbundle.block.block import Block


def with_interior_held(block: Block) -> Block:
    """The block with every interior element of its cameras held at its value."""
    structure = dataclasses.replace(block.structure, interior_free=np.zeros_like(block.structure.interior_free))
    return dataclasses.replace(block, structure=structure)
