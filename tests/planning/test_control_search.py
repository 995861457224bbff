"""Search for control: updates of the covariance, exchange, and the lower bound."""

import itertools

import numpy as np
import pytest
from cases.schematic_flights import UNIT

from jaxbundle.planning.control_candidates import Candidates, candidates_of, ground_sigma
from jaxbundle.planning.control_search import (
    Objective,
    best_layout,
    conditioned,
    exchange,
    greedy,
    onto_capped_simplex,
    relaxation,
    value_of,
)
from jaxbundle.planning.flight import ControlSet, schematic
from jaxbundle.planning.prediction import predict
from jaxbundle.planning.simulation import simulate_flight


@pytest.fixture(scope="module")
def small():
    """Ten points with some covariance, all of them candidates."""
    root = np.random.default_rng(3).normal(size=(30, 40))
    covariance = root @ root.T / 40
    n = np.arange(10)
    return Candidates(
        n,
        n,
        np.diag(covariance).reshape(10, 3),
        covariance.reshape(10, 3, 10, 3),
        covariance.reshape(10, 3, 10, 3),
        np.array([0.1, 0.1, 0.2]),
    )


def test_conditioning_is_that_of_the_normal_equations(small):
    covariance = small.own.reshape(30, 30)
    information = np.linalg.inv(covariance)
    for k in (2, 7):
        information[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += np.diag(1 / small.noise)
    after = conditioned(small, [2, 7])
    assert np.allclose(after.own.reshape(30, 30), np.linalg.inv(information))
    assert np.allclose(after.variances.ravel(), np.diag(np.linalg.inv(information)))


@pytest.mark.parametrize("objective", [Objective(), Objective("worst"), Objective("mean", (1, 1, 0))])
def test_exchange_finds_the_best_of_all_layouts(small, objective):
    best = min(value_of(small, list(three), objective) for three in itertools.combinations(range(10), 3))
    found = best_layout(small, 3, objective)
    assert found.objective == pytest.approx(best, rel=1e-9)
    assert not found.bound > best


def test_exchange_never_ends_worse_than_it_started(small):
    for criterion in ("mean", "worst"):
        objective = Objective(criterion)
        start = greedy(small, 4, objective)
        assert value_of(small, exchange(small, start, objective), objective) <= value_of(small, start, objective)


def test_bound_is_below_all_layouts_and_tight_where_all_are_chosen(small):
    z, bound = relaxation(small, 4)
    assert z.sum() == pytest.approx(4) and z.min() >= 0 and z.max() <= 1
    values = [value_of(small, list(four), Objective()) for four in itertools.combinations(range(10), 4)]
    assert 0 < bound < min(values)
    _, all_of_them = relaxation(small, 10)
    assert all_of_them == pytest.approx(value_of(small, list(range(10)), Objective()), rel=1e-3)


def test_capped_simplex():
    z = onto_capped_simplex(np.array([3.0, 0.5, 0.4, -1.0]), 2.0)
    assert z.sum() == pytest.approx(2) and z[0] == 1 and z[3] == 0
    assert z[1] - z[2] == pytest.approx(0.1)


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: best_layout(c, 11), "11 control points of 10 candidates; give 1 to 10"),
        (lambda c: best_layout(c, 2, Objective("least")), "criterion 'least' is unknown; there are mean, worst"),
        (lambda c: relaxation(c._replace(noise=np.zeros(3)), 2), "errorless control cannot be divided"),
    ],
)
def test_what_the_search_refuses(small, call, message):
    with pytest.raises(ValueError, match=message):
        call(small)


@pytest.mark.thorough
def test_search_on_a_block():
    """Eight of all tie point places of 4 x 9 photographs: as good as an independent exchange, and as predicted."""
    plan = schematic(strips=4, images=9)
    truth = simulate_flight(plan).truth
    assert ground_sigma(truth) == pytest.approx(UNIT)
    every = np.arange(len(truth.structure.point_names))
    candidates = candidates_of(truth, every, (0.5 * UNIT,) * 3, prior=1000 * UNIT)
    found = best_layout(candidates, 8)
    assert found.objective / UNIT**2 < 1.02 * 3.92
    assert 0 < found.bound < found.objective and found.gap == pytest.approx(0.79, abs=0.03)

    places = tuple((float(x), float(y)) for x, y in np.asarray(truth.object_points)[found.points, :2])
    control = ControlSet("points", sigmas=(0.5 * UNIT,) * 3, points=places)
    flown = simulate_flight(schematic(strips=4, images=9, control=(control,))).truth
    variances = np.asarray(predict(flown).standard_deviations.object_points) ** 2
    # the weak control of all places adds a little
    assert variances.mean() == pytest.approx(found.objective, rel=2e-3)


@pytest.mark.thorough
def test_search_in_a_block_of_large_overlap():
    truth = simulate_flight(schematic(strips=6, images=8, side_overlap=0.6)).truth
    every = np.arange(len(truth.structure.point_names))
    candidates = candidates_of(truth, every, (0.5 * UNIT,) * 3, prior=1000 * UNIT)
    found = best_layout(candidates, 8)
    assert found.objective / UNIT**2 < 1.02 * 1.29
    assert found.bound / UNIT**2 == pytest.approx(0.555, abs=0.005)
