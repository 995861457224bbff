"""The coordinate reference system of a block, from its source text."""

from jaxbundle.block.block import Block

MARK = "coordinate system: "


def system_of(block: Block) -> str:
    """The text of the system; "" where it is unknown."""
    return block.structure.source.partition(MARK)[2].strip()
