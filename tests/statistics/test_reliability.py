"""Redundancy numbers, standardised residuals, detectable errors and data snooping, against theory and by many draws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import drawn, in_batches, strip
from jaxtyping import Array
from scipy.stats import binom, chi2, kstest, norm

from jaxbundle.block.datum import with_datum
from jaxbundle.numerics.compilation import QUICKLY
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.reliability_tables import (
    LEVEL,
    POWER,
    UNCONTROLLED,
    critical_tau,
    critical_w,
    level_of_one,
    non_centrality,
    reliability,
)
from jaxbundle.statistics.snooping import snoop

DRAWS = 1000
ONE_IN_A_MILLION = 1e-6


@pytest.fixture(scope="module")
def truth():
    return with_datum(strip())


@pytest.fixture(scope="module")
def reported(truth):
    return adjust(truth)


@pytest.fixture(scope="module")
def planted(reported) -> tuple[int, float]:
    """A well controlled ray, and the smallest error in its x that is found with the stated power."""
    tables = reliability(reported)
    ray = int(np.argmax(tables.redundancy_numbers[0][:, 0]))
    return ray, float(tables.minimal_detectable[0][ray, 0])


@pytest.fixture(scope="module")
def sample(truth, planted):
    """Without gross errors w of all rays, v^T P v and the largest |w| of all observations that are controlled; w of the
    ray with an error of the size of its MDE."""
    ray, error = planted

    def w_of(adjustment: Adjustment) -> list[Array]:
        assert adjustment.redundancy_numbers is not None
        tables = zip(adjustment.weighted_residuals, adjustment.redundancy_numbers, strict=True)
        return [jnp.where(r > UNCONTROLLED, v / jnp.sqrt(jnp.where(r > 0, r, 1.0)), 0.0) for v, r in tables]

    def one(key: Array):
        block = drawn(truth, key)
        clean = adjust(block, max_iterations=20)
        spoilt = eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates.at[ray, 0].add(error))
        found = adjust(spoilt, max_iterations=20)
        w = w_of(clean)
        largest = jnp.max(jnp.concatenate([jnp.abs(table).ravel() for table in w]))
        return w[0], clean.vtpv, largest, w_of(found)[0][ray, 0]

    return jax.jit(in_batches(one), compiler_options=QUICKLY)(jax.random.split(jax.random.key(3), DRAWS))


def binomial_limits(probability: float, draws: int = DRAWS) -> tuple[float, float]:
    low, high = binom.ppf([ONE_IN_A_MILLION / 2, 1 - ONE_IN_A_MILLION / 2], draws, probability)
    return low / draws, high / draws


@pytest.mark.thorough
def test_w_is_standard_normal(sample):
    w = np.asarray(sample[0])
    controlled = w.std(0) > 0.5
    assert controlled.mean() > 0.5
    for k in np.argwhere(controlled)[::7]:
        assert kstest(w[:, k[0], k[1]], "norm", method="asymp").pvalue > 1e-5


@pytest.mark.thorough
def test_global_test_rejects_at_its_level(sample, truth):
    rejected = np.asarray(sample[1]) > chi2.ppf(0.95, truth.redundancy)
    low, high = binomial_limits(0.05)
    assert low < rejected.mean() < high


@pytest.mark.thorough
def test_detectable_error_is_detected_with_its_power(sample):
    found = np.abs(np.asarray(sample[3])) > critical_w(LEVEL)
    low, high = binomial_limits(POWER)
    assert low < found.mean() < high


@pytest.mark.thorough
def test_no_clean_observation_is_suspected_in_95_of_100_blocks(sample, truth):
    """The largest |w| of a block against Sidak's limit: that is what snooping looks at first."""
    limit = critical_w(level_of_one(0.05, truth.n_observations))
    suspected = np.asarray(sample[2]) > limit
    assert suspected.mean() < binomial_limits(0.05)[1]


def test_constants():
    assert non_centrality(0.001, 0.80) == pytest.approx(4.13, abs=0.005)  # Baarda's 4.13
    assert critical_w(0.001) == pytest.approx(3.29, abs=0.005)
    assert level_of_one(0.05, 1) == pytest.approx(0.05)
    assert 1 - (1 - level_of_one(0.05, 300)) ** 300 == pytest.approx(0.05)
    assert critical_tau(10**7, 0.001) == pytest.approx(norm.isf(0.0005), abs=1e-4)
    assert critical_tau(5, 0.001) < np.sqrt(5)  # tau is bounded by the root of the redundancy
    with pytest.raises(ValueError, match="redundancy of at least 2"):
        critical_tau(1)


@pytest.fixture(scope="module")
def clean_block():
    return simulate(2, 4, forward_overlap=0.7, points_per_image=60, control_rows=4, control_sigma=0.05, seed=6).block


def test_reliability_needs_redundancy_numbers(clean_block):
    with pytest.raises(ValueError, match="precision=True"):
        reliability(adjust(clean_block, precision=False))


def test_gross_errors_in_rays_and_control_are_found_and_named(clean_block):
    s, groups = clean_block.structure, clean_block.groups
    count = np.bincount(s.ray_point)[s.ray_point]
    tie = s.point_free.all(1)[s.ray_point] & ~np.isin(s.ray_point, groups[0].structure.indices)
    bad = np.flatnonzero((count >= 4) & tie)[[3, 40]]
    rays = clean_block.rays.coordinates.at[bad].add(jnp.array([[30.0, 0.0], [0.0, -40.0]]))
    control = groups[0].values.at[1, 2].add(3.0).at[4, 0].add(-3.0)
    block = eqx.tree_at(lambda b: (b.rays.coordinates, b.groups[0].values), clean_block, (rays, control))
    found = snoop(adjust(block))
    assert found.complete
    names = {(removed.names, removed.table, removed.component) for removed in found.removed}
    points = [s.point_names[i] for i in groups[0].structure.indices[:, 0]]
    expected = {((s.image_names[s.ray_image[r]], s.point_names[s.ray_point[r]]), "ray", "") for r in bad}
    expected |= {((points[1],), "control", "Z"), ((points[4],), "control", "X")}
    assert expected <= names
    assert len(names) <= len(expected) + 1  # at most one good one, as one of twenty blocks may lose
    assert 0.8 < float(found.adjustment.sigma0) < 1.2
    assert "without it sigma0 is" in str(found.removed[0])


def test_point_left_with_one_ray_goes_too(clean_block):
    s = clean_block.structure
    count = np.bincount(s.ray_point)
    free = ~np.isin(np.arange(len(count)), np.concatenate([g.structure.indices[:, 0] for g in clean_block.groups]))
    point = int(np.flatnonzero((count == 2) & free & s.point_free.all(1))[0])
    ray = int(np.flatnonzero(s.ray_point == point)[0])
    coordinates = clean_block.rays.coordinates.at[ray, 1].add(60.0)  # across the base, where it is seen
    found = snoop(adjust(eqx.tree_at(lambda b: b.rays.coordinates, clean_block, coordinates)), most=3)
    assert s.point_names[point] not in found.adjustment.block.structure.point_names
    assert len(found.adjustment.block.structure.ray_image) == len(s.ray_image) - 2
