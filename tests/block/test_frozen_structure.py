"""What is static under jit cannot be changed in place: compiled programs and plans would not notice."""

import dataclasses

import numpy as np
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.block.observation_kinds import CONTROL, GroupStructure

BLOCK = small_block().block


def _arrays(holder) -> dict[str, np.ndarray]:
    values = {field.name: getattr(holder, field.name) for field in dataclasses.fields(holder)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize(
    "holder", [BLOCK.structure, *(group.structure for group in BLOCK.groups)], ids=lambda s: type(s).__name__
)
def test_arrays_are_read_only(holder):
    arrays = _arrays(holder)
    assert len(arrays) >= 2
    for array in arrays.values():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_a_cached_property_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        BLOCK.structure.ray_repeat[...] = 1


def test_the_array_of_the_caller_stays_writable_and_apart():
    indices, observed = np.array([[0], [1]]), np.ones((2, 3), bool)
    structure = GroupStructure(CONTROL, indices, observed)
    indices[0, 0], observed[0, 0] = 7, False
    assert structure.indices.tolist() == [[0], [1]] and structure.observed.all()


def test_a_changed_structure_shares_what_is_not_changed():
    structure = BLOCK.structure
    other = dataclasses.replace(structure, name="another")
    assert other.ray_image is structure.ray_image and other is not structure
