"""Whether two blocks are the same, and where something is in one."""

import dataclasses

import jax
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import ObservationGroup, ObservationKind


def group_of(block: Block, kind: ObservationKind) -> ObservationGroup:
    (group,) = [group for group in block.groups if group.structure.kind == kind]
    return group


def number(block: Block, name: str) -> int:
    return [parameter.name for parameter in block.structure.parameters].index(name)


def assert_same(block: Block, again: Block, rounding: float = 4e-15) -> None:
    """Equal structures and values, angles to rounding; findings tell of the folder alone."""
    for field in dataclasses.fields(block.structure):
        if field.name != "findings":
            value, value_again = (getattr(structure, field.name) for structure in (block.structure, again.structure))
            same = np.array_equal(value, value_again) if isinstance(value, np.ndarray) else value == value_again
            assert same, field.name

    def values(b: Block) -> tuple:
        return b.exterior, b.interior, b.object_points, b.rays, b.check_points, b.parameters

    for one, two in zip(jax.tree.leaves(values(block)), jax.tree.leaves(values(again)), strict=True):
        np.testing.assert_allclose(one, two, rtol=rounding)
    assert len(block.groups) == len(again.groups)
    for group, group_again in zip(block.groups, again.groups, strict=True):
        assert_same_group(group, group_again, rounding)


def assert_same_group(group: ObservationGroup, again: ObservationGroup, rounding: float) -> None:
    name = group.structure.kind.name
    assert group.structure.kind == again.structure.kind
    np.testing.assert_array_equal(group.structure.indices, again.structure.indices, name)
    np.testing.assert_array_equal(group.structure.observed, again.structure.observed, name)
    for values, values_again in ((group.values, again.values), (group.sigmas, again.sigmas)):
        np.testing.assert_allclose(values, values_again, rtol=rounding, err_msg=name)
    np.testing.assert_allclose(group.constants, again.constants, rtol=rounding, atol=1e-14, err_msg=name)
    assert (group.covariances is None) == (again.covariances is None)
    if group.covariances is not None and again.covariances is not None:
        both = group.structure.observed[:, :, None] & group.structure.observed[:, None, :]
        covariances = (np.where(both, np.asarray(c), 0) for c in (group.covariances, again.covariances))
        np.testing.assert_allclose(*covariances, rtol=rounding)
