"""Blocks built in Python written as folders, and what of a block has no place in one."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases import all_observations as heterogeneous
from cases.same_block import assert_same_group, number
from cases.surveyed_site import PAIRS, make_surveyed_folder

from jaxbundle.block.block import Block, Parameter
from jaxbundle.block.observation_kinds import CONTROL, ObservationGroup
from jaxbundle.block.problems import BlockError
from jaxbundle.io import read_block_folder, write_block_folder


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Block:
    return read_block_folder(make_surveyed_folder(tmp_path_factory.mktemp("surveyed") / "site"))


def conforming(block: Block) -> Block:
    """The block in the order and with the names of the format, observed values of figures 0."""
    kinds = [*PAIRS, "directions", "scale_bars", "plumb_lines", "planes", "lines"]
    zero = {"scale_bars", "plumb_lines", "planes", "lines"}
    groups = [
        eqx.tree_at(lambda g: g.values, group, 0 * group.values) if group.structure.kind.name in zero else group
        for group in block.groups
    ]
    order = ["control", *kinds, "stations", "attitudes", "interior", "parameters"]
    groups.sort(key=lambda group: order.index(group.structure.kind.table))
    return dataclasses.replace(block, groups=tuple(groups))


@pytest.mark.parametrize("name", ["geodetic", "figures", "navigation"])
def test_blocks_built_in_python(tmp_path: Path, name: str) -> None:
    """Their parameters get the names of the format, planes and lines frames of their own; all else is as it was."""
    block = conforming(heterogeneous.CASES[name](heterogeneous.strip()))
    write_block_folder(block, tmp_path / "block")
    again = read_block_folder(tmp_path / "block")
    assert (again.n_observations, again.structure.n_unknowns) == (block.n_observations, block.structure.n_unknowns)
    to_again = [again.structure.point_names.index(point) for point in block.structure.point_names]
    by_kind = {(group.structure.kind.name, group.structure.kind.touches): group for group in again.groups}
    assert len(by_kind) == len(again.groups) == len(block.groups)
    for group in block.groups:
        kind = group.structure.kind
        found = by_kind[kind.name, kind.touches]
        np.testing.assert_allclose(found.values, group.values, rtol=4e-15, atol=1e-300)
        np.testing.assert_allclose(found.sigmas, group.sigmas, rtol=4e-15)
        for k, touched in enumerate(kind.touches):
            if touched == "point":
                expected = [to_again[p] for p in group.structure.indices[:, k]]
                np.testing.assert_array_equal(found.structure.indices[:, k], expected)
        parameters = [k for k, touched in enumerate(kind.touches) if touched == "parameter"]
        for row, row_again in zip(
            group.structure.indices[:, parameters], found.structure.indices[:, parameters], strict=True
        ):
            free = [[b.structure.parameters[p].free for p in r] for b, r in ((block, row), (again, row_again))]
            assert free[0] == free[1]
            if kind.table in ("scale_bars", "stations", "attitudes", "parameters"):
                np.testing.assert_allclose(block.parameters[row], again.parameters[row_again], rtol=4e-15)


def test_covariances_built_in_python(tmp_path: Path) -> None:
    block = heterogeneous.correlated(heterogeneous.strip())
    block = dataclasses.replace(block, groups=block.groups[1:])
    write_block_folder(block, tmp_path / "block")
    again = read_block_folder(tmp_path / "block")
    for group, group_again in zip(block.groups, again.groups, strict=True):
        group = with_points_of(again, block, group)
        group = dataclasses.replace(group, sigmas=group_again.sigmas)  # not read where there are covariances
        group = eqx.tree_at(lambda g: g.values, group, jnp.where(group.structure.observed, group.values, 0.0))
        assert_same_group(group, group_again, 4e-15)


def with_points_of(again: Block, block: Block, group: ObservationGroup) -> ObservationGroup:
    """A group of control with the numbers that the points have in the other block."""
    if group.structure.kind != CONTROL:
        return group
    names = [block.structure.point_names[p] for p in group.structure.indices[:, 0]]
    indices = np.array([[again.structure.point_names.index(name)] for name in names])
    return dataclasses.replace(group, structure=dataclasses.replace(group.structure, indices=indices))


def without_zeros(block: Block) -> Block:
    """Scale bars with an observed value that is not 0."""
    groups = tuple(
        eqx.tree_at(lambda g: g.values, g, g.values + 1) if g.structure.kind.name == "scale_bars" else g
        for g in block.groups
    )
    return dataclasses.replace(block, groups=groups)


def renamed(block: Block, **changes) -> Block:
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, **changes))


def with_parameter(block: Block, name: str, **changes) -> Block:
    k = number(block, name)
    parameters = list(block.structure.parameters)
    parameters[k] = dataclasses.replace(parameters[k], **changes)
    return renamed(block, parameters=tuple(parameters))


def with_indices(block: Block, name: str, change_of) -> Block:
    """A block of which a kind of observation touches something else."""

    def changed(group: ObservationGroup) -> ObservationGroup:
        if group.structure.kind.table != name or len(group.structure.kind.touches) == 1:
            return group
        indices = np.array(group.structure.indices)
        change_of(indices)
        return dataclasses.replace(group, structure=dataclasses.replace(group.structure, indices=indices))

    return dataclasses.replace(block, groups=tuple(map(changed, block.groups)))


def share_lever_arm(indices: np.ndarray) -> None:
    indices[:, 1:4] = indices[0, 1:4]


def one_set(indices: np.ndarray) -> None:
    indices[:, 2] = 0


UNWRITABLE = {
    "values": (without_zeros, "observed values of scale_bars are not 0; the format has only their sigmas"),
    "held orientation": (
        lambda b: with_parameter(b, "orientation of set A", free=False),
        "parameter orientation of set A of directions is fixed or observed",
    ),
    "held bar": (
        lambda b: with_parameter(b, "length of bar long", free=False),
        "length of bar long is both observed and fixed; make it unknown",
    ),
    "shift in part": (
        lambda b: with_parameter(b, "shift Y of strip 1", free=False),
        "the three components of shift, such as shift X of strip 1, are not all unknown with one sigma",
    ),
    "shared lever arm": (
        lambda b: with_indices(b, "stations", share_lever_arm),
        "parameter lever_arm X of strip 1 belongs to several groups; give each group its own parameters",
    ),
    "two stations": (
        lambda b: with_indices(b, "directions", one_set),
        "parameter orientation of set A orients directions from several stations",
    ),
    "lost parameter": (
        lambda b: eqx.tree_at(
            lambda c: c.parameters,
            renamed(b, parameters=(*b.structure.parameters, Parameter("tide"))),
            jnp.append(b.parameters, 0.0),
        ),
        "parameter tide belongs to no observation of a block folder; leave it out",
    ),
    "held element": (
        lambda b: renamed(b, interior_free=np.zeros_like(b.structure.interior_free)),
        "principal_distance of camera wide is both observed and fixed; make it unknown",
    ),
    "name of a point": (
        lambda b: renamed(b, point_names=("image:1", *b.structure.point_names[1:])),
        "the name of point image:1 begins with 'image:'; rename it",
    ),
}


@pytest.mark.parametrize("name", UNWRITABLE)
def test_what_cannot_be_written(block: Block, tmp_path: Path, name: str) -> None:
    change_of, expected = UNWRITABLE[name]
    with pytest.raises(BlockError) as caught:
        write_block_folder(change_of(block), tmp_path / "again")
    assert any(expected in line for line in caught.value.lines), caught.value
    assert not (tmp_path / "again").exists()
