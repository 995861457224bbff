"""Monte Carlo of complete adjustments against the prediction, and what moves an adjusted coordinate."""

import numpy as np
import pytest
from cases.schematic_flights import block_plan, gnss_plan, heights

import jaxbundle as jb
from jaxbundle.planning.flight import ControlSet, FlightPlan, Ties, schematic
from jaxbundle.planning.monte_carlo_runs import monte_carlo
from jaxbundle.planning.prediction import predict
from jaxbundle.planning.sensitivities import sensitivity
from jaxbundle.planning.simulation import simulate_flight

pytestmark = pytest.mark.thorough

STRIP = FlightPlan(
    1, 3, ties=Ties("grid", 12), headings=(1.2,), control=(ControlSet("corners", sigmas=(0.05, 0.05, 0.0)),), seed=3
)


@pytest.fixture(scope="module")
def truth():
    return simulate_flight(STRIP).truth


def test_scatter_agrees_with_the_prediction(truth):
    found = monte_carlo(truth, draws=500, seed=1)
    assert found.passed and found.converged == 500
    sd = (2 * truth.redundancy * 500) ** -0.5  # of the root of the mean of chi-square / redundancy
    assert found.sigma0 == pytest.approx(1, abs=4 * sd)
    assert found.mean == pytest.approx(1, abs=4 * found.mean_sigma)
    with pytest.raises(ValueError, match="5 draws are too few; give at least 20"):
        monte_carlo(truth, draws=5)


@pytest.fixture(scope="module")
def point(truth):
    """A tie point."""
    return int(np.flatnonzero(truth.structure.point_free.all(1))[3])


@pytest.fixture(scope="module")
def effects(truth, point):
    """What moves its height."""
    return sensitivity(truth, lambda b: b.object_points[point, 2])


def test_effects_add_up_to_the_variance(truth, point, effects):
    found = effects
    sd = np.asarray(predict(truth).standard_deviations.object_points)[point, 2]
    assert found.standard_deviation == pytest.approx(sd, rel=1e-6)
    assert found.value == pytest.approx(float(truth.object_points[point, 2]), abs=1e-6)
    sizes = [abs(e.effect) for e in found.effects]
    assert sizes == sorted(sizes, reverse=True)
    fixed = [e.derivative for e in found.held if e.subject.table == "control" and e.subject.component == "Z"]
    assert len(fixed) == 4 and sum(fixed) == pytest.approx(1, abs=0.02)  # all raised together raise the point as much
    (distance,) = [e for e in found.held if e.subject.component == "principal_distance"]
    assert distance.unit == "mm" and abs(distance.derivative) > 0
    with pytest.raises(ValueError, match="the function returns an array of shape \\(3,\\); return one number"):
        sensitivity(truth, lambda b: b.object_points[point])


def test_a_longer_principal_distance_does_what_its_derivative_says(truth, point, effects):
    (distance,) = [e for e in effects.held if e.subject.component == "principal_distance"]
    elements = truth.interior.elements
    changed = jb.adjust(
        jb.Block(
            truth.structure,
            truth.exterior,
            jb.blocks.InteriorOrientation(elements.at[0, 0].add(0.001)),
            truth.object_points,
            truth.rays,
            truth.groups,
            truth.check_points,
            truth.parameters,
        ),
        precision=False,
    )
    moved = float(changed.block.object_points[point, 2] - truth.object_points[point, 2])
    assert moved == pytest.approx(0.001 * distance.derivative, rel=1e-3)


CASES = {
    "strip": schematic(
        images=11, control=(ControlSet("points", points=((0, -900), (0, 900), (900, -900), (900, 900))),)
    ),
    "block": block_plan(5, 11, (ControlSet("corners", "plan"), heights(5))),
    "gnss": gnss_plan("a", "strip"),
}


@pytest.mark.parametrize("name", CASES)
def test_scatter_of_five_hundred_adjustments(name):
    found = monte_carlo(simulate_flight(CASES[name]).truth, draws=500, seed=2)
    single = found.ratios[np.isfinite(found.ratios)]
    assert found.converged == 500
    assert found.mean == pytest.approx(1, abs=4 * found.mean_sigma)
    assert found.limits == pytest.approx((0.80, 1.22), abs=0.01)
    assert found.share_outside < 0.02 and 0.7 < single.min() and single.max() < 1.35
    assert found.sigma0 == pytest.approx(1, abs=0.01)
