"""The dense system beside a design matrix by other means: redundancy numbers of every kind, cofactors, its limits."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from cases.all_observations import case
from cases.dense_adjustment import centred, dense_cofactors, dense_system, masks
from cases.six_photographs import drawn, true_block

from jaxbundle.block.block import Block
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.weight_functions import Huber
from jaxbundle.statistics import dense
from jaxbundle.statistics.dense import block_system, redundancy_numbers
from jaxbundle.statistics.subsets import all_observations


@pytest.mark.parametrize("name", ["correlated", "navigation"])
def test_every_kind_of_observation(name):
    """Against Householder's QR of the design matrix, whose observations have another order."""
    block = case(name)
    system = block_system(block)
    numbers = system.tables(1 - np.sum(system.orthogonal**2, 1))
    assert abs(sum(table.sum() for table in numbers) - block.redundancy) < 1e-9
    unknowns, observations = centred(block)
    design = dense_system(unknowns, observations).design
    orthogonal, first = np.linalg.qr(design / np.linalg.norm(design, axis=0))[0], 0
    for table, mask in zip(numbers, all_observations(block).masks, strict=True):
        own = 1 - np.sum(orthogonal[first : first + mask.size] ** 2, 1).reshape(mask.T.shape).T
        np.testing.assert_allclose(table, np.where(mask, own, 0.0), rtol=0, atol=1e-9)
        first += mask.size
    cofactors = np.diag(dense_cofactors(unknowns, observations))
    np.testing.assert_allclose(np.sum(system.inverse**2, 1), cofactors, rtol=1e-7)
    assert len(system.unknown_names) == block.structure.n_unknowns == sum(mask.sum() for mask in masks(observations))


def test_tables_and_names():
    block = case("correlated")
    system = block_system(block)
    tables = system.unknown_tables(np.arange(float(block.structure.n_unknowns)))
    names = system.unknown_names
    image = block.structure.image_names[1]
    assert names[int(tables.exterior[1, 4])] == f"phi of image {image}"
    column = block.structure.interior_columns[0]
    assert names[int(tables.interior[0, column])] == "principal_distance of camera camera"
    assert names[int(tables.object_points[3, 2])] == f"Z of point {block.structure.point_names[3]}"
    assert np.isnan(np.delete(tables.interior[0], column)).all()


@pytest.fixture(scope="module")
def block() -> Block:
    return true_block()


def test_robust_weights_are_seen(block):
    """A ray of no weight controls nothing."""
    coordinates = np.asarray(drawn(block, 0).rays.coordinates).copy()
    coordinates[30] += 0.2
    wrong = eqx.tree_at(lambda b: b.rays.coordinates, block, coordinates)
    adjustment = adjust(wrong, precision=False, robust=Huber())
    assert adjustment.reweighting is not None
    weights = np.asarray(adjustment.reweighting.weights)
    assert weights[30] < 0.1
    numbers = redundancy_numbers(adjustment)
    assert (numbers[0][30] > 0.95).all()
    assert abs(sum(table.sum() for table in numbers) - adjustment.redundancy) < 1e-9


def test_limits(block, monkeypatch):
    with pytest.raises(ValueError, match="some unknowns are undetermined"):
        block_system(dataclasses.replace(block, groups=()))
    monkeypatch.setattr(dense, "MAX_UNKNOWNS", 10)
    with pytest.raises(ValueError, match="limited to 10 unknowns; the block has 162"):
        block_system(block)
