"""What variance components do where a group has little to say, and what they refuse."""

from functools import reduce
from operator import or_

import equinox as eqx
import numpy as np
import pytest
from cases.all_observations import case
from cases.six_photographs import SIGMAS, drawn, true_block, with_sigmas

from jaxbundle.block.block import Block
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.weight_functions import Huber
from jaxbundle.statistics import components, dense
from jaxbundle.statistics.components import FALLEN, LIMIT, REST, SMALL, variance_components, with_components
from jaxbundle.statistics.dense import redundancy_numbers
from jaxbundle.statistics.subsets import (
    Subset,
    all_control,
    control_point,
    control_rays,
    default_groups,
    image_coordinates,
    observations_of_kind,
    tie_rays,
)


@pytest.fixture(scope="module")
def block() -> Block:
    return drawn(true_block(), 1)


def test_small_groups_keep_their_sigmas(block):
    one, *others = (control_point(block, str(k)) for k in range(1, 13))
    rest = reduce(or_, others)
    found = variance_components(block, [control_rays(block), tie_rays(block), one, rest], precision=False)
    assert found.converged and found.held == ("", "", SMALL, "")
    assert found.redundancy[2] < 3 and found.components[2] == 1 and np.isnan(found.deviations[2])
    assert found.sigmas[2] == pytest.approx(SIGMAS[2])
    assert "sigma a priori: redundancy below 3" in found.summary()


def test_a_group_may_be_freed_later(block):
    """Control has no redundancy beside image coordinates that are claimed too bad, until these have gained weight."""
    claimed = with_sigmas(block, 0.05, 0.02)
    numbers = redundancy_numbers(adjust(claimed, precision=False))
    assert numbers[1].sum() < 3
    found = variance_components(claimed, form="helmert", tolerance=1e-4, precision=False)
    assert found.converged and found.held == ("", "", "")
    again = variance_components(with_sigmas(block, 0.005, 0.1), form="helmert", tolerance=1e-4, precision=False)
    np.testing.assert_allclose(found.sigmas, again.sigmas, rtol=1e-3)


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_what_is_not_asked_for(block):
    found = variance_components(block, [image_coordinates(block)], precision=False)
    assert found.names == ("image coordinates", "other observations") and found.held == ("", REST)
    assert found.components[1] == 1 and found.redundancy.sum() == pytest.approx(found.adjustment.redundancy, abs=1e-9)
    at_unit = found.adjustment.weighted_residuals[0]
    assert float((np.asarray(at_unit) ** 2).sum()) == pytest.approx(found.redundancy[0], rel=1e-5)


def test_observations_without_errors_reach_the_limit(block):
    """Rays of tie points that fit exactly would have all weight in the end."""
    true, ties = true_block(), tie_rays(block)
    exact = np.where(ties.masks[0], true.rays.coordinates, block.rays.coordinates)
    block = eqx.tree_at(lambda b: b.rays.coordinates, block, exact)
    found = variance_components(block, max_rounds=200, precision=False)
    assert found.converged and found.held == ("", LIMIT, "")
    assert found.components[1] == 1e-6


def test_negative_components():
    """Of control without errors Helmert's equations find less than nothing; then its sigmas stay as they were."""
    true = true_block()
    block = eqx.tree_at(lambda b: b.groups[0].values, drawn(true, 1), true.groups[0].values)
    found = variance_components(with_sigmas(block, 0.006, 0.05), form="helmert", precision=False)
    assert found.converged and found.negative == ("control",) and found.held == ("", "", FALLEN)
    assert found.components[2] == 1 and np.isnan(found.deviations[2])
    assert "control: the component was negative during the iterations" in found.summary()
    simple = variance_components(with_sigmas(block, 0.006, 0.05), tolerance=1e-8, precision=False)
    assert simple.negative == () and simple.held == ("", "", FALLEN)
    np.testing.assert_allclose(found.sigmas, simple.sigmas, rtol=1e-5)


def test_not_converged(block):
    found = variance_components(with_sigmas(block, 0.02, 1.0), max_rounds=1, precision=False)
    assert not found.converged and found.rounds == 1
    assert "NOT CONVERGED" in found.summary()


def test_large_blocks_have_bounds(block, monkeypatch):
    """Where there is no S: lower bounds, which hold and are not far off."""
    usual = variance_components(block, tolerance=1e-4, precision=False)
    numbers = redundancy_numbers(usual.adjustment)
    monkeypatch.setattr(components, "redundancy_numbers", lambda adjustment: numbers)
    monkeypatch.setattr(dense, "MAX_UNKNOWNS", 10)
    found = variance_components(block, tolerance=1e-2, precision=False)
    assert found.deviations_are_bounds and not usual.deviations_are_bounds
    assert "lower bounds" in found.summary()
    bounds, exact = found.deviations / found.components, usual.deviations / usual.components
    assert (bounds <= exact).all() and (bounds > 0.7 * exact).all()
    with pytest.raises(ValueError, match="the block has 162"):
        variance_components(block, form="helmert")


def test_correlated_components_are_scaled_together():
    block = case("correlated")
    control = observations_of_kind(block, "control")
    weights = [group.weights for group in block.groups]
    scaled = [group.weights for group in with_components(block, [control], np.array([4.0])).groups]
    for group, before, after in zip(block.groups, weights, scaled, strict=True):
        factor = 0.5 if group.structure.kind.name == "control" else 1.0
        observed = group.structure.observed if before.ndim == 2 else group.structure.observed[:, :, None]
        np.testing.assert_allclose(np.where(observed, after, 0), np.where(observed, factor * before, 0), rtol=1e-12)
    heights = observations_of_kind(block, "control", ["Z"])
    with pytest.raises(ValueError, match="correlated with the others"):
        variance_components(block, [heights])


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_refusals(block):
    with pytest.raises(ValueError, match="no form 'mixed'"):
        variance_components(block, form="mixed")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="choose one"):
        variance_components(block, robust=Huber())
    with pytest.raises(ValueError, match="shares observations with a group before"):
        variance_components(block, [*default_groups(block), all_control(block)])
    with pytest.raises(ValueError, match="nothing has no observations"):
        variance_components(block, [Subset("nothing", tuple(m & False for m in all_control(block).masks))])
    with pytest.raises(ValueError, match="adjustment 1 stopped at the maximum number"):
        variance_components(with_sigmas(block, 0.006, 0.05), max_iterations=1)


def test_inseparable_groups():
    matrix = np.array([[2.0, 2.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="join some of the groups"):
        components._separable(matrix)
