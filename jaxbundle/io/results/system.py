"""The coordinate reference system of a block, as its source says."""

from jaxbundle.block.block import Block

MARK = "coordinate system: "


def system_of(block: Block) -> str:
    """The text of the system; "" where it is not known."""
    return block.structure.source.partition(MARK)[2].strip()
