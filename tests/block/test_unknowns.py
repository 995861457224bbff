"""A block as unknowns, whatever cameras it has."""

import dataclasses

from cases.all_observations import case

from jaxbundle.block.block import InteriorOrientation
from jaxbundle.block.unknowns import unknowns_of


def test_a_block_without_cameras_has_no_interior_elements():
    block = case("correlated")
    structure = dataclasses.replace(block.structure, cameras=(), interior_free=block.structure.interior_free[:0])
    interior = InteriorOrientation(block.interior.elements[:0])
    found = unknowns_of(dataclasses.replace(block, structure=structure, interior=interior))
    assert found.interior.shape[1] == 0 and found.points.shape == block.object_points.T.shape
