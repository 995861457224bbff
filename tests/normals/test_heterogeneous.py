"""Every kind of observation and every unknown: eliminated as they are densely, and scattering as they are reported."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import case, drawn
from cases.dense_adjustment import centred, dense_cofactors, dense_step, dense_system, difference, free_values, sizes
from cases.dense_steps import DAMPINGS, block_steps
from jaxtyping import Array
from scipy.stats import chi2

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.numerics.compilation import QUICKLY
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status

DRAWS = 500
ONE_IN_A_MILLION = 1e-6


@pytest.fixture(scope="module")
def block() -> Block:
    return case("all observations")


@pytest.fixture(scope="module")
def reported(block) -> Adjustment:
    """Without errors: the cofactors are those at the truth."""
    return adjust(block)


@pytest.mark.thorough
def test_steps(block):
    """From values with errors, at all dampings."""
    start = drawn(block, jax.random.key(1))
    moved = start.object_points + np.where(start.structure.point_free, 1.0, 0.0) * np.random.default_rng(0).normal(
        0, 0.5, start.object_points.shape
    )
    start = eqx.tree_at(lambda b: b.object_points, start, moved)
    unknowns, observations = centred(start)
    system = dense_system(unknowns, observations)
    assert len(system.lengths) == start.structure.n_unknowns
    rounding = np.finfo(float).eps * np.linalg.norm(system.lengths * sizes(unknowns, observations))
    for damping, stepped in zip(DAMPINGS, block_steps(start, DAMPINGS, "auto", 1), strict=True):
        expected = dense_step(system, damping)
        off = difference(unknowns, stepped, observations) - expected
        allowed = 1e-10 * np.linalg.norm(system.lengths * expected) + rounding
        assert np.linalg.norm(system.lengths * off) < allowed, damping


def test_truth_is_found_and_counted(block, reported):
    assert reported.trustworthy
    assert float(reported.vtpv) < 1e-12
    assert reported.n_unknowns == block.structure.n_unknowns
    np.testing.assert_allclose(reported.block.parameters, block.parameters, atol=1e-7)
    for group, residuals in zip(block.groups, reported.residuals[1:], strict=True):
        assert residuals.shape == group.values.shape


def test_standard_deviations(block, reported):
    expected = np.sqrt(np.diagonal(dense_cofactors(*centred(reported.block))))
    q = reported.cofactors
    roots = [
        jnp.sqrt(jnp.diagonal(x, axis1=-2, axis2=-1)) for x in (q.exterior, q.interior, q.parameters, q.object_points)
    ]
    _, o = centred(block)
    found = free_values(roots[0][:, :3].T, roots[0][:, 3:].T, roots[1].T, roots[2], roots[3].T, o)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_redundancy_numbers_are_those_of_the_dense_equations(reported):
    unknowns, observations = centred(reported.block)
    design = dense_system(unknowns, observations).design
    leverages = 1 - np.sum(np.linalg.qr(design / np.linalg.norm(design, axis=0))[0] ** 2, 1)
    found = np.concatenate([np.asarray(r).T.ravel() for r in reported.redundancy_numbers])
    mask = [np.ones(reported.residuals[0].shape), *(g.structure.observed for g in reported.block.groups)]
    observed = np.concatenate([np.asarray(m, bool).T.ravel() for m in mask])
    np.testing.assert_allclose(found[observed], leverages[observed], atol=1e-9)
    assert not found[~observed].any()
    assert found.sum() == pytest.approx(reported.redundancy, rel=1e-9)


@pytest.mark.thorough
def test_scatter_is_the_reported_covariance(block, reported):
    """All unknowns together, 500 adjustments in one program: e^T Q^-1 e and v^T P v follow their chi-squares."""

    def one(key: Array):
        found = adjust(drawn(block, key), precision=False, max_iterations=20)
        return unknowns_of(found.block), found.block.exterior.angles, found.vtpv, found.iterations.status

    unknowns, angles, vtpv, status = jax.jit(jax.vmap(one), compiler_options=QUICKLY)(
        jax.random.split(jax.random.key(8), DRAWS)
    )
    assert (np.asarray(status) == Status.CONVERGED).all()
    truth, (_, o) = unknowns_of(block), centred(block)
    errors = np.array(
        [
            free_values(
                unknowns.centre[k] - truth.centre,
                (angles[k] - block.exterior.angles).T,
                unknowns.interior[k] - truth.interior,
                unknowns.parameters[k] - truth.parameters,
                unknowns.points[k] - truth.points,
                o,
            )
            for k in range(DRAWS)
        ]
    )
    q = dense_cofactors(*centred(reported.block))
    scale = np.sqrt(np.diagonal(q))
    normed = np.linalg.solve(np.linalg.cholesky(q / scale / scale[:, None]), (errors / scale).T)
    for total, degrees in (
        (float((normed**2).sum()), normed.size),
        (float((normed.mean(1) ** 2).sum()) * DRAWS, len(normed)),
        (float(vtpv.sum()), DRAWS * block.redundancy),
    ):
        lower, upper = chi2.ppf([ONE_IN_A_MILLION / 2, 1 - ONE_IN_A_MILLION / 2], degrees)
        assert lower < total < upper, (total / degrees, lower / degrees, upper / degrees)
