"""Simulated blocks with known truth: bundle, models and strips against each other and against laws of accuracy."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases.gruber_blocks import columns_and_rows, gruber_block, perimeter, with_control
from cases.noise import with_noise

import jaxbundle as jb
from jaxbundle.block.findings import Kind
from jaxbundle.independent.model_adjustment import formed
from jaxbundle.independent.model_block import model_block
from jaxbundle.independent.polynomials import Form, correction, elements
from jaxbundle.independent.sensors import factor_numbers
from jaxbundle.independent.strip_block import curb_group, normalised, polynomial_block, polynomial_sensors

pytestmark = [pytest.mark.thorough, pytest.mark.xdist_group("methods compared")]
DRAWS = 8


@pytest.fixture(scope="module")
def simulation() -> jb.planning.Simulation:
    return jb.simulate(2, 7, control_sigma=0.02, points_per_image=30, control_rows=4, seed=1)


def test_unbiased_and_as_precise_as_reported(simulation):
    """Scatter of the models' coordinates over their standard deviations by propagation is 1; the mean error is 0."""
    truth, errors, ratios = np.asarray(simulation.truth.object_points), [], []
    deviations, points = None, np.zeros(0, int)
    for seed in range(DRAWS):
        result = jb.independent.adjust_models(with_noise(simulation, seed))
        if deviations is None:
            precision = result.propagated()
            assert precision is not None and 1.0 < precision.ratio < 1.4
            assert precision.sigma0 == pytest.approx(1.0, abs=0.2)
            points = result.points
            deviations = precision.standard_deviations.object_points[: len(points)] / precision.sigma0
        if np.array_equal(result.points, points):
            errors.append(result.object_points - truth[points])
    ratios = np.array(errors) / deviations
    free = np.isfinite(ratios).all(0)
    scatter = np.sqrt(np.mean(ratios[:, free] ** 2))
    assert scatter == pytest.approx(1.0, abs=0.12)
    assert np.sqrt(np.mean(ratios.mean(0)[free] ** 2)) < 1.5 / np.sqrt(len(errors))


def test_law_of_heights():
    """Lines of height control across the strips, i models apart: the mean standard deviation grows linearly with i.

    The law of 1972, 0.34 + 0.22 i, holds within 26 % for standard deviations of 0.7 and 1 of ground points in plan and
    height, 1.6 and 0.6 of projection centres (Ackermann, Ebner, Klein 1973).
    """
    block = gruber_block(4, 12)
    models, _ = formed(block, None)
    column, _ = columns_and_rows(block)
    found, bridged = [], (2, 3, 4, 6)
    for i in bridged:
        controlled = with_control(block, perimeter(block), column % i == 0)
        of_models = model_block(controlled, models, False)
        found.append(_mean_height(of_models, len(block.structure.point_names)))
    law = 0.34 + 0.22 * np.array(bridged)
    np.testing.assert_allclose(found, law, rtol=0.26)
    slope, start = np.polyfit(bridged, found, 1)
    np.testing.assert_allclose(found, start + slope * np.array(bridged), rtol=0.05)


def _mean_height(of_models, points: int) -> float:
    """Mean standard deviation of free heights with the weights of the law."""
    block, count = of_models.block, len(of_models.points)
    assert count <= points
    ground = block.structure.ray_point < count
    deviations = np.where(ground[:, None], [0.7, 0.7, 1.0], [1.6, 1.6, 0.6])
    numbers = np.array(block.rays.coordinates)
    numbers[:, 3:9] = factor_numbers(deviations[:, :, None] ** 2 * np.eye(3))
    weighted = jb.blocks.Rays(jnp.asarray(numbers), block.rays.sigmas)
    result = jb.adjust(_with(block, weighted))
    assert result.cofactors is not None
    q = np.asarray(result.cofactors.object_points)[:count, 2, 2]
    return float(np.sqrt(q[block.structure.point_free[:count, 2]]).mean())


def _with(block: jb.Block, rays: jb.blocks.Rays) -> jb.Block:
    return jb.Block(
        block.structure, block.exterior, block.interior, block.object_points, rays, block.groups, block.check_points
    )


@pytest.fixture(scope="module")
def strips(simulation) -> jb.independent.StripAdjustment:
    return jb.independent.adjust_strips(simulation.block, form="conformal")


def test_strips(simulation, strips):
    """Corrected points agree with the truth to three times the noise within a model; the strips start the bundle."""
    truth = np.asarray(simulation.truth.object_points)
    assert strips.adjustment.status is jb.Status.CONVERGED and not [f for f in strips.findings if f.kind is Kind.WEAK]
    for strip, frame, corrected in zip(strips.strips, strips.frames, strips.corrected, strict=True):
        assert np.abs(normalised(frame, frame.coordinates)[:, 0]).max() == pytest.approx(1.0)
        off = corrected.coordinates - truth[corrected.point]
        noise = np.sqrt(np.trace(strip.covariances, axis1=1, axis2=2))
        assert np.sqrt(np.mean(np.sum(off**2, 1) / noise**2)) < 3.0
    started = jb.adjust(strips.block, precision=False)
    assert int(started.iterations.accepted) < int(jb.adjust(simulation.block, precision=False).iterations.accepted) + 1


@pytest.mark.parametrize("degree", [2, 3])
def test_bent_strips_are_straightened(simulation, strips, degree):
    """Strips of exact coordinates, bent by polynomials of up to 20 m and disturbed by noise, come back to the noise."""
    how: tuple[Form, int] = "separate", degree
    rng = np.random.default_rng(degree)
    truth, bent, names = simulation.truth, [], strips.adjustment.block.structure.image_names
    points, centres = np.asarray(truth.object_points), np.asarray(truth.exterior.projection_centre)
    bends = [rng.uniform(-20, 20, len(elements(*how))) for _ in names]
    for strip, frame, c in zip(strips.strips, strips.frames, bends, strict=True):
        there = (np.concatenate([points[strip.points], centres[strip.images]]) - frame.origin) @ frame.axes
        x = there.copy()
        for _ in range(20):  # x + T(x) C is the true place
            x = there - np.stack(np.broadcast_arrays(*correction(*how, tuple(c), tuple(normalised(frame, x).T))), 1)
        noise = np.concatenate([strip.covariances, strip.centre_covariances])
        noise = frame.turned @ noise @ frame.turned.T
        x += np.einsum("pij,pj->pi", np.linalg.cholesky(noise), rng.standard_normal(x.shape))
        bent.append(frame._replace(coordinates=x))
    sensors = polynomial_sensors(truth, strips.strips, tuple(bent), names, how)
    no_curb = curb_group([{"X": 1e4, "Y": 1e4, "Z": 1e4} for _ in names], how)
    of_strips = polynomial_block(simulation.block, strips.strips, tuple(bent), sensors, no_curb)
    adjusted = jb.adjust(of_strips.block)
    assert abs(float(adjusted.sigma0) - 1) < 3 / np.sqrt(2 * adjusted.redundancy)
    count = len(of_strips.points)
    off = np.asarray(adjusted.block.object_points)[:count] - points[of_strips.points]
    deviations = np.asarray(adjusted.standard_deviations.object_points)[:count]
    assert np.sqrt(np.mean((off / deviations) ** 2)) == pytest.approx(1.0, abs=0.2)
    found, sd = np.asarray(adjusted.block.interior.elements), np.asarray(adjusted.standard_deviations.interior)
    assert np.sqrt(np.mean(((found - np.array(bends)) / sd) ** 2)) < 2.0


def test_plan_and_height(simulation):
    """The iteration converges by a factor of more than 10 per round, to within a few standard deviations."""
    found, simultaneous = jb.independent.plan_height(simulation.block), jb.independent.adjust_models(simulation.block)
    assert found.converged and (found.changes[1:-1] < 0.1 * found.changes[:-2]).all()
    sd = np.asarray(simultaneous.adjustment.standard_deviations.object_points)[: len(found.points)]
    difference = found.object_points - simultaneous.object_points
    assert np.sqrt(np.mean((difference / sd) ** 2)) < 1.0
