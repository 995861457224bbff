"""Changes of a planned flight and their derivatives, with measures of the block in place of its predicted precision."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbundle as jb
from jaxbundle.planning import design_derivatives
from jaxbundle.planning.accuracy import control_of

PLAN = jb.planning.schematic(
    strips=1, images=3, control=(jb.planning.ControlSet("corners", sigmas=(0.02, 0.02, 0.03)),)
)
CONTROL = np.array([0, 1])
REACH = 10.0


@pytest.fixture(scope="module")
def truth() -> jb.Block:
    return jb.planning.simulate_flight(PLAN).truth


@pytest.fixture
def of_blocks(monkeypatch):
    """Measures are functions of the block: a prediction would compile for long."""
    monkeypatch.setattr(design_derivatives, "predict", lambda block: block)


def test_a_higher_flight_is_stretched_about_its_centre(truth):
    same = jb.planning.stretched(truth, PLAN, jb.planning.Stretch())
    np.testing.assert_allclose(same.object_points, truth.object_points, rtol=1e-12)
    higher = jb.planning.stretched(truth, PLAN, jb.planning.Stretch(height=0.1))
    raised = np.asarray(higher.exterior.projection_centre - truth.exterior.projection_centre)[:, 2]
    assert raised.mean() == pytest.approx(0.1 * PLAN.height)
    plan, before = (np.asarray(block.object_points)[:, :2] for block in (higher, truth))
    np.testing.assert_allclose(plan - plan.mean(0), 1.1 * (before - before.mean(0)), atol=1e-9)
    np.testing.assert_array_equal(higher.object_points[:, 2], truth.object_points[:, 2])


def test_derivatives_of_a_measure(truth, of_blocks):
    """The measure sums the mean height of the stations, the sigmas of the rays and three times an X of control."""
    (point, *_) = np.flatnonzero(control_of(truth))

    def measure(block):
        return (
            jnp.mean(block.exterior.projection_centre[:, 2])
            + jnp.sum(block.rays.sigmas)
            + 3 * block.object_points[point, 0]
        )

    found = jb.planning.derivatives_of(truth, PLAN, measure)
    assert found.value == pytest.approx(float(measure(truth)))
    np.testing.assert_allclose(found.control_positions[0], [3, 0, 0], atol=1e-12)
    assert found.image_sigma == pytest.approx(float(jnp.sum(truth.rays.sigmas)))
    middle = np.asarray(truth.object_points)[:, 0].mean()
    assert found.height == pytest.approx(1 + 3 * float(truth.object_points[point, 0] - middle) / PLAN.height)


def test_control_moves_to_the_minimum_within_its_reach(truth, of_blocks):
    start = np.asarray(truth.object_points)[CONTROL, :2]
    near, far = start[0] + 0.4 * REACH, start[1] + np.array([3.0 * REACH, 0.0])
    target = jnp.asarray(np.stack([near, far]))

    def measure(block):
        return jnp.sum((block.object_points[CONTROL, :2] - target) ** 2)

    better, values = jb.planning.steepest_positions(truth, CONTROL, measure, REACH, steps=30)
    assert values == sorted(values, reverse=True) and values[-1] < values[0]
    found = np.asarray(better.object_points)[CONTROL, :2]
    assert np.abs(found - start).max() <= REACH + 1e-9
    np.testing.assert_allclose(found, [near, start[1] + np.array([REACH, 0.0])], atol=0.1 * REACH)


def test_relevant_points_lie_in_the_area(truth):
    judged = jb.planning.in_area(truth, PLAN)
    assert not judged[control_of(truth)].any() and judged.any()
    x, y = np.asarray(truth.object_points)[:, :2].T
    square = ((x.min() - 1, y.min() - 1), (x.mean(), y.min() - 1), (x.mean(), y.max() + 1), (x.min() - 1, y.max() + 1))
    np.testing.assert_array_equal(
        jb.planning.in_area(truth, dataclasses.replace(PLAN, area=square)), judged & (x < x.mean())
    )


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: jb.planning.monte_carlo(b, draws=5), "5 draws are too few; give at least 20"),
        (lambda b: jb.planning.sensitivity(b, lambda b: b.object_points[0]), r"an array of shape \(3,\); return one"),
        (lambda b: jb.planning.candidates_of(b, CONTROL, (0.1,) * 3, "some"), "control of kind 'some' is unknown"),
        (lambda b: jb.planning.candidates_of(b, np.array([-1]), (0.1,) * 3), "candidates are numbers of points from 0"),
    ],
)
def test_what_is_refused_before_computing(truth, call, message):
    with pytest.raises(ValueError, match=message):
        call(truth)
