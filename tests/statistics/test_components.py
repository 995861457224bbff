"""Variance components find the accuracies that observations were drawn with, and say how well."""

import numpy as np
import pytest
from cases.dense_adjustment import centred, dense_system
from cases.six_photographs import SIGMAS, drawn, true_block, with_sigmas
from scipy.stats import chi2, f

from jaxbundle.block.block import Block
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics import dense
from jaxbundle.statistics.components import VarianceComponents, helmert_system, variance_components
from jaxbundle.statistics.dense import redundancy_numbers
from jaxbundle.statistics.subsets import default_groups

RUNS = 40
A_PRIORI = np.array([0.005, 0.005, 0.1])  # what the adjuster believes
FOUND, SCATTER = np.array([0.00791, 0.00397, 0.0504]), np.array([0.00056, 0.00019, 0.0104])  # of 40 runs elsewhere
ONE_IN_A_MILLION = 1e-6  # two-sided level of a single test, the seeds being fixed
SIZE = 4.9  # of a normal variable at that level


@pytest.fixture(scope="module")
def truth() -> Block:
    return true_block()


@pytest.fixture(scope="module")
def exact(truth) -> Adjustment:
    """At the truth, with true sigmas."""
    return adjust(truth, precision=False)


@pytest.fixture(scope="module")
def predicted(truth, exact) -> np.ndarray:
    """Standard deviations of the three components over the true ones: sqrt(2 S^-1)."""
    system = helmert_system(dense.dense_system(exact), default_groups(truth))
    return np.sqrt(2 * np.diag(np.linalg.inv(system.matrix)))


def disbelieved(truth: Block, seed: int) -> Block:
    """A draw whose sigmas a priori are wrong."""
    return with_sigmas(drawn(truth, seed), A_PRIORI[0], A_PRIORI[2])


@pytest.fixture(scope="module")
def runs(truth) -> list[VarianceComponents]:
    """To 1e-4, a thousandth of a standard deviation."""
    return [
        variance_components(disbelieved(truth, k), form="helmert", tolerance=1e-4, precision=False) for k in range(RUNS)
    ]


def test_redundancies_add_up(truth, exact):
    system = helmert_system(dense.dense_system(exact), default_groups(truth))
    assert abs(system.redundancy.sum() - exact.redundancy) < 1e-9
    np.testing.assert_allclose(system.matrix.sum(1), system.redundancy, rtol=0, atol=1e-9)
    np.testing.assert_allclose(system.matrix, system.matrix.T, rtol=0, atol=1e-12)
    numbers = redundancy_numbers(exact)
    by_group = [sum(t[m].sum() for t, m in zip(numbers, g.masks, strict=True)) for g in default_groups(truth)]
    np.testing.assert_allclose(by_group, system.redundancy, rtol=0, atol=1e-9)


def test_trace_formula(truth, exact):
    """S as it is printed, by N^-1 and N_i."""
    design = dense_system(*centred(exact.block)).design
    groups = [np.concatenate([mask.T.ravel() for mask in group.masks]) for group in default_groups(truth)]
    scaled = design / np.linalg.norm(design, axis=0)
    shares = [np.linalg.solve(scaled.T @ scaled, scaled[rows].T @ scaled[rows]) for rows in groups]
    s = np.array([[np.trace(a @ b) for b in shares] for a in shares])
    s += np.diag([rows.sum() - 2 * np.trace(share) for rows, share in zip(groups, shares, strict=True)])
    np.testing.assert_allclose(helmert_system(dense.dense_system(exact), default_groups(truth)).matrix, s, atol=1e-6)


def test_one_run_finds_the_true_accuracies(truth, predicted):
    """Each within 4.9 of its predicted standard deviations."""
    run = variance_components(disbelieved(truth, 0), form="helmert", tolerance=1e-4, precision=False)
    assert run.converged and run.held == ("", "", "")
    assert run.adjustment.sigma0 == pytest.approx(1, abs=1e-4)
    assert (np.abs(run.sigmas - SIGMAS) < SIZE * SIGMAS * predicted / 2).all()
    np.testing.assert_allclose(run.factor_deviations, run.deviations / 2 / run.factors)
    text = run.summary()
    assert "converged after" in text and "rays of tie points" in text and "C^2" in text


@pytest.mark.thorough
def test_every_run_converges(runs):
    assert all(run.converged and run.held == ("", "", "") for run in runs)
    assert all(run.adjustment.sigma0 == pytest.approx(1, abs=1e-4) for run in runs)


@pytest.mark.thorough
def test_true_accuracies_are_found(runs, predicted):
    """Means, within the standard deviation of a mean of 40; a root's mean lies below the root by var / 8."""
    sigmas = np.array([run.sigmas for run in runs])
    expected, sd = SIGMAS * (1 - predicted**2 / 8), SIGMAS * predicted / 2
    assert (np.abs(sigmas.mean(0) - expected) < SIZE * sd / np.sqrt(RUNS)).all()
    assert (np.abs(sigmas.mean(0) - FOUND) < SIZE * np.hypot(sd, SCATTER) / np.sqrt(RUNS)).all()
    assert (
        np.abs(np.array([run.components for run in runs]).mean(0) * A_PRIORI**2 / SIGMAS**2 - 1)
        < SIZE * predicted / np.sqrt(RUNS)
    ).all()


@pytest.mark.thorough
def test_scatter_is_as_predicted(runs, predicted):
    """Variances of 40 sigmas follow chi-square with 39 degrees, the ratio of two such follows F."""
    scatter, sd = np.std([run.sigmas for run in runs], axis=0, ddof=1), SIGMAS * predicted / 2
    lower, upper = chi2.ppf([ONE_IN_A_MILLION / 2, 1 - ONE_IN_A_MILLION / 2], RUNS - 1) / (RUNS - 1)
    assert (lower < (scatter / sd) ** 2).all() and ((scatter / sd) ** 2 < upper).all()
    most = f.ppf(1 - ONE_IN_A_MILLION / 2, RUNS - 1, RUNS - 1)
    assert (np.maximum(scatter / SCATTER, SCATTER / scatter) ** 2 < most).all()
    # the prediction has no scatter of its own: only that of the 40 runs elsewhere is left
    assert (lower < (SCATTER / sd) ** 2).all() and ((SCATTER / sd) ** 2 < upper).all()


@pytest.mark.thorough
def test_reported_deviations(runs, predicted):
    """What each run says of itself, relative to what it found, is what is true to a few hundredths of r."""
    relative = np.array([run.deviations / run.components for run in runs])
    np.testing.assert_allclose(relative.mean(0), predicted, rtol=0.05)


def test_both_forms_agree(truth):
    block = disbelieved(truth, 0)
    one, two = (
        variance_components(block, form=form, tolerance=1e-8, precision=False) for form in ("redundancy", "helmert")
    )
    assert one.converged and two.converged and one.rounds > two.rounds
    np.testing.assert_allclose(one.components, two.components, rtol=1e-6)
    np.testing.assert_allclose(one.deviations, two.deviations, rtol=1e-6)
    np.testing.assert_allclose(one.coordination, one.components[0] / one.components)
    np.testing.assert_allclose(one.sigmas, A_PRIORI * one.factors)
    assert one.redundancy.sum() == pytest.approx(one.adjustment.redundancy, abs=1e-9)
