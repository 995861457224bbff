"""Blocks without control."""

import dataclasses

import numpy as np

from jaxbundle.block.block import Block, Datum
from jaxbundle.planning.simulation import simulate


def free_network(strips: int = 1) -> Block:
    """Strips of three images, with no control at all."""
    block = simulate(strips, 3, control_rows=0, check_points=0, points_per_image=30).block
    free = np.ones_like(block.structure.exterior_free)
    return dataclasses.replace(
        block, structure=dataclasses.replace(block.structure, exterior_free=free, datum=Datum("open"))
    )


def inner(block: Block, points: tuple[str, ...] = ()) -> Block:
    return dataclasses.replace(
        block, structure=dataclasses.replace(block.structure, datum=Datum("inner", points=points))
    )
