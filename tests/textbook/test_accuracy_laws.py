"""The laws of accumulation: the worked examples of the sources, recomputed, and how far the approximations are off."""

import numpy as np
import pytest

from jaxbundle.textbook.accuracy_laws import (
    BUNDLE,
    PRINTED,
    StripSetup,
    accumulation,
    block_factor,
    bundle_free_end,
    close_accumulation,
    free_end,
    printed_accumulation,
    random_walk_middle,
    spacing,
    tied_middle,
)

EXAMPLE = StripSetup(1.0, 0.01, 70.0, 70.0)  # mm, at photo scale


def test_exact_sums_and_the_errors_of_the_approximations():
    n = np.arange(1, 41)
    exact = accumulation(n)
    assert np.allclose(exact**2, np.cumsum(n**2))
    low = 1 - np.asarray(printed_accumulation(n)) / exact
    assert low[[4, 9, 19]] == pytest.approx([0.126, 0.065, 0.032], abs=6e-4)
    assert np.abs(np.asarray(close_accumulation(n[4:])) / np.asarray(exact)[4:] - 1).max() < 0.0042


def test_the_worked_example():
    assert free_end(10, EXAMPLE) == pytest.approx([0.348, 0.180, 0.294], abs=1e-3)
    assert tied_middle(10, EXAMPLE) == pytest.approx([0.087, 0.045, 0.0735], abs=1e-3)
    # the print gives 0.08, 0.05, 0.08: X and Z do not follow from its own constants, Y does
    assert [round(float(x), 2) for x in tied_middle(10, EXAMPLE)] == [0.09, 0.05, 0.07]


def test_half_of_the_pairs_over_root_two_is_a_quarter():
    by_rule = free_end(5, EXAMPLE) / np.sqrt(2)
    assert tied_middle(10, EXAMPLE) == pytest.approx(by_rule, rel=1e-12)
    assert tied_middle(10, EXAMPLE, ends="clamped") / free_end(10, EXAMPLE) == pytest.approx([0.125, 0.125, 0.25])


def test_random_walk_tied_at_both_ends():
    """Directions are a random walk, positions their sum; conditioned on both end positions by least squares."""
    n = 8
    walk = np.tril(np.ones((n, n)))  # sums of independent steps of direction
    positions = walk @ walk @ walk.T @ walk.T
    assert positions[-1, -1] == pytest.approx(accumulation(n) ** 2)
    line = np.zeros((n, n))
    line[:, -1] = np.arange(1, n + 1) / n  # the first direction is free: the straight line to the end is taken out
    tied = (np.eye(n) - line) @ positions @ (np.eye(n) - line).T
    assert np.sqrt(tied[n // 2 - 1, n // 2 - 1]) == pytest.approx(random_walk_middle(n))


@pytest.mark.parametrize(
    ("setup", "tolerance", "pairs", "n", "distance", "predicted"),
    [
        ((10000, 1e-5, 0.07, 0.07), (0.8, 0.5, 0.8), (9.46, 10.72, 10.58), 9, 6300, (0.743, 0.385, 0.628)),
        ((10000, 1e-5, 0.07, 0.07), (1, 1, 1), (10.98, 17.01, 12.28), 10, 7000, (0.870, 0.451, 0.735)),
        ((20000, 1e-5, 0.1, 0.07), (2, 2, 1), (10.98, 17.01, 6.10), 6, 8400, (0.808, 0.419, 0.976)),
        ((10000, 5e-6, 0.153, 0.092), (0.5, 0.5, 0.3), (10.98, 17.01, 6.22), 6, 5520, (0.202, 0.105, 0.284)),
    ],
)
def test_distance_between_control(setup, tolerance, pairs, n, distance, predicted):
    found = spacing(tolerance, StripSetup(*setup))
    assert found.pairs_by_coordinate == pytest.approx(pairs, abs=6e-3)
    assert found.pairs == n and found.distance == pytest.approx(distance)
    assert found.predicted == pytest.approx(predicted, abs=1e-3)


def test_bundle_and_print():
    """Constants of a bundle: 31 % below the print in X at most, the height's 0.93 f/b is that of ten bases."""
    for n, expected in ((10, (0.839, 0.658, 1.539)), (20, (0.918, 0.731, 1.597)), (60, (0.972, 0.787, 1.640))):
        assert bundle_free_end(n) / n**1.5 == pytest.approx(expected, rel=5e-3)
    ratio = 153 / 92
    assert bundle_free_end(10)[2] / 10**1.5 / ratio == pytest.approx(PRINTED.Z, rel=0.01)
    limit = bundle_free_end(100_000) / 100_000**1.5
    assert limit == pytest.approx([BUNDLE.X, BUNDLE.Y, BUNDLE.Z * ratio], abs=0.01)


def test_block_factor():
    assert [block_factor(s) for s in (2, 3, 4, 6, 8)] == pytest.approx([1.26, 1.44, 1.59, 1.82, 2.0], abs=5e-3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: free_end(10, EXAMPLE._replace(base=0.0)), "base is 0.0; give a positive number"),
        (lambda: spacing((1, -1, 1), EXAMPLE), "give positive ones"),
        (lambda: spacing((1e-4, 1, 1), EXAMPLE), "the tolerance of X allows 0.11 stereopairs"),
        (lambda: tied_middle(10, EXAMPLE, ends="glued"), "ends 'glued' are unknown; there are hinged, clamped"),
        (lambda: bundle_free_end(10, 70), "no cubic for 70 % overlap; there are 60, 80 %"),
        (lambda: random_walk_middle(5), "5 stereopairs have no point in the middle"),
        (lambda: block_factor(0), "0 strips; give 1 or more"),
    ],
)
def test_what_the_laws_refuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()
