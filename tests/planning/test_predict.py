"""Predictions: those of an adjustment without errors, what they find, and their derivatives."""

import equinox as eqx
import jax
import numpy as np
import pytest
from cases.simulated_blocks import small_block

import jaxbundle as jb
from jaxbundle.planning.accuracy import (
    Specification,
    check_specification,
    control_of,
    mean_variance,
    point_variances,
    smooth_share,
    smooth_worst,
    summary_of,
)
from jaxbundle.planning.design_derivatives import Stretch, derivatives_of, steepest_positions, stretched
from jaxbundle.planning.flight import ControlSet, FlightPlan, Navigation, Terrain, Ties
from jaxbundle.planning.prediction import predict
from jaxbundle.planning.simulation import simulate_flight
from jaxbundle.solve.adjust import adjust


@pytest.fixture(scope="module")
def blocks():
    return small_block(noise=0.0)


@pytest.fixture(scope="module")
def prediction(blocks):
    return predict(blocks.truth)


def test_prediction_is_that_of_an_adjustment_without_errors(blocks, prediction):
    adjusted = adjust(blocks.block)
    assert adjusted.cofactors is not None and adjusted.redundancy_numbers is not None
    for found, expected in zip(prediction.cofactors, adjusted.cofactors, strict=True):
        scale = np.abs(expected).max(initial=1e-300)
        assert np.allclose(found, expected, rtol=1e-7, atol=1e-9 * scale)
    for found, expected in zip(prediction.redundancy_numbers, adjusted.redundancy_numbers, strict=True):
        assert np.allclose(found, expected, atol=1e-8)
    assert not prediction.undetermined


def test_measured_values_take_no_part(blocks, prediction):
    noisy = eqx.tree_at(lambda b: b.rays.coordinates, blocks.truth, blocks.truth.rays.coordinates + 5.0)
    again = predict(noisy).standard_deviations.object_points
    assert np.allclose(again, prediction.standard_deviations.object_points, rtol=1e-9)


def test_measures_and_specifications(blocks, prediction):
    numbers = summary_of(prediction)
    variances = np.asarray(point_variances(prediction))
    assert numbers.judged == len(variances) == (~control_of(blocks.truth)).sum()
    assert float(mean_variance()(prediction)) == pytest.approx((variances).mean())
    worst = variances.mean(1).max()
    assert 0.7 * worst < float(smooth_worst()(prediction)) <= worst
    limits = Specification(float(numbers.maximum[:2].max()) * 1.01, float(numbers.maximum[2]) * 1.01)
    assert check_specification(prediction, limits).passed
    tight = check_specification(prediction, limits._replace(z=float(numbers.median[2])))
    assert not tight.passed and tight.share_z == pytest.approx(0.5, abs=0.02) and tight.share_xy == 1
    assert 0.5 < float(smooth_share(limits)(prediction)) < 1
    assert prediction.reliability().minimal_detectable[0].shape == prediction.block.rays.coordinates.shape
    with pytest.raises(ValueError, match="give positive limits"):
        check_specification(prediction, Specification(0.0, 1.0))


@pytest.mark.thorough
def test_what_is_not_determined_is_told():
    """A shift of each strip takes the scale of flat ground away from an unknown principal distance."""
    plan = FlightPlan(
        2,
        4,
        camera=jb.planning.AerialCamera(estimate=("principal_distance", "x0", "y0")),
        terrain=Terrain(),
        tilt=0.0,
        scatter=0.0,
        ties=Ties("grid", 12),
        gnss=Navigation((0.05,) * 3, "strip"),
        control=(ControlSet("corners", sigmas=(0.02,) * 3),),
    )
    found = predict(simulate_flight(plan).truth)
    assert found.undetermined
    assert float(jb.planning.mean_variance()(found)) == float(jb.planning.smooth_worst()(found)) == np.inf
    limits = jb.planning.Specification(xy=1e3, z=1e3)
    assert not jb.planning.check_specification(found, limits).passed and jb.planning.smooth_share(limits)(found) == 0.0


STRIP = FlightPlan(
    1,
    3,
    ties=Ties("grid", 12),
    headings=(1.2,),
    control=(ControlSet("corners", sigmas=(0.05, 0.05, 0.08)),),
    seed=3,
)


@pytest.mark.thorough
def test_derivatives_of_a_predicted_accuracy():
    truth = simulate_flight(STRIP).truth
    measure = mean_variance()
    found = derivatives_of(truth, STRIP, measure)

    def difference(block_of, step):
        """Central, without its error of second order."""
        wide, narrow = (
            (float(measure(predict(block_of(h)))) - float(measure(predict(block_of(-h))))) / (2 * h)
            for h in (step, step / 2)
        )
        return (4 * narrow - wide) / 3

    def close(derivative, block_of, step):
        assert derivative == pytest.approx(difference(block_of, step), rel=1e-6, abs=1e-9 * found.value)

    point = int(found.control[1])
    for axis in range(3):
        close(
            found.control_positions[1, axis],
            lambda h, a=axis: eqx.tree_at(lambda b: b.object_points, truth, truth.object_points.at[point, a].add(h)),
            4.0,
        )
    close(
        found.control_sigmas[1, 2],
        lambda h: eqx.tree_at(lambda b: b.groups[0].sigmas, truth, truth.groups[0].sigmas.at[1, 2].add(h)),
        1e-3,
    )
    close(found.image_sigma, lambda h: eqx.tree_at(lambda b: b.rays.sigmas, truth, truth.rays.sigmas * (1 + h)), 1e-2)
    close(found.height, lambda h: stretched(truth, STRIP, Stretch(height=h / STRIP.height)), 10.0)
    p, q = STRIP.forward_overlap, STRIP.side_overlap
    close(found.forward_overlap, lambda h: stretched(truth, STRIP, Stretch(along=-h / (1 - p))), 4e-3)
    close(found.side_overlap, lambda h: stretched(truth, STRIP, Stretch(across=-h / (1 - q))), 4e-3)
    weighted, shared = smooth_worst(), smooth_share(Specification(0.1, 0.2))
    for other in (weighted, shared):
        by_sigma = jax.grad(lambda s, m=other: m(predict(eqx.tree_at(lambda b: b.rays.sigmas, truth, s))))
        assert np.isfinite(np.asarray(by_sigma(truth.rays.sigmas))).all()

    better, values = steepest_positions(truth, found.control, measure, reach=50.0, steps=4)
    assert values == sorted(values, reverse=True) and values[-1] < values[0]
    moved = np.abs(np.asarray(better.object_points - truth.object_points))
    assert 0 < moved.max() <= 50 + 1e-9 and float(measure(predict(better))) == pytest.approx(values[-1])
