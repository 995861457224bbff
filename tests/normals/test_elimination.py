"""Elimination changes nothing: steps and standard deviations are those of the dense equations."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases.block_variants import BLOCKS
from cases.dense_adjustment import centred, dense_cofactors, dense_system, free_values, masks
from cases.dense_steps import assert_dense_steps
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status


@pytest.fixture(scope="module", params=BLOCKS)
def block(request) -> Block:
    """Two strips with weighted and fixed control, observed stations and self-calibration, and something more."""
    return BLOCKS[request.param](small_block().block)


def test_steps(block):
    assert_dense_steps(block, "auto")


def test_steps_in_panels():
    assert_dense_steps(BLOCKS["shared cameras"](small_block().block), "panels", 2)


@pytest.mark.parametrize("name", [pytest.param("shared cameras", marks=pytest.mark.thorough), "private cameras"])
def test_steps_by_conjugate_gradients(name):
    assert_dense_steps(BLOCKS[name](small_block().block), "pcg")


@pytest.fixture(scope="module")
def adjustment(block) -> Adjustment:
    """By the program of the steps."""
    return adjust(block, method="gauss-newton")


def test_standard_deviations(adjustment):
    """At the minimum, the attitudes in the user's angles."""
    assert adjustment.status is Status.CONVERGED
    unknowns, observations = centred(adjustment.block)
    expected = float(adjustment.sigma0) * np.sqrt(np.diagonal(dense_cofactors(unknowns, observations)))
    sd = adjustment.standard_deviations
    interior = jnp.pad(sd.interior, ((0, 0), (0, unknowns.interior.shape[0] - sd.interior.shape[1])))
    found = free_values(
        sd.projection_centre.T, sd.angles.T, interior.T, sd.parameters, sd.object_points.T, observations
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    exterior_free, interior_free, parameter_free, point_free = masks(observations)
    held = exterior_free.T, interior_free.T, parameter_free, point_free.T
    exterior = np.hstack([sd.projection_centre, sd.angles])
    columns = np.asarray(sd.interior)[:, np.array(observations.columns, int)]
    for values, free in zip(
        (exterior, columns, np.asarray(sd.parameters), np.asarray(sd.object_points)), held, strict=True
    ):
        assert not values[~free].any()  # what is held has none


def test_redundancy_numbers(adjustment):
    """Each is 1 less the leverage of its row, and they sum to the redundancy."""
    system = dense_system(*centred(adjustment.block))
    leverages = np.sum(np.linalg.qr(system.design / system.lengths)[0] ** 2, 1)
    assert adjustment.redundancy_numbers is not None
    found = np.concatenate([np.asarray(r).T.ravel() for r in adjustment.redundancy_numbers])
    observed = system.design.any(1)
    np.testing.assert_allclose(found[observed], 1 - leverages[observed], atol=1e-9)
    assert found.sum() == pytest.approx(adjustment.redundancy, rel=1e-9)
