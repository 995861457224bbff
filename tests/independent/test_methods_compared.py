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
MODELS, SIZE = 6, 1.0  # models of a strip; m, error of the end of a model by its own scale and direction


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


def _adjusted(simulation, strips, how: tuple[Form, int], places: list[np.ndarray]):
    """Strips whose points and centres stand at these places, disturbed by their noise, adjusted by polynomials.

    Returns: the adjustment, and the errors of its object points.
    """
    rng = np.random.default_rng(how[1])
    names, disturbed = strips.adjustment.block.structure.image_names, []
    for strip, frame, place in zip(strips.strips, strips.frames, places, strict=True):
        noise = np.concatenate([strip.covariances, strip.centre_covariances])
        factor = np.linalg.cholesky(frame.turned @ noise @ frame.turned.T)
        errors = np.einsum("pij,pj->pi", factor, rng.standard_normal(place.shape))
        disturbed.append(frame._replace(coordinates=place + errors))
    sensors = polynomial_sensors(simulation.truth, strips.strips, tuple(disturbed), names, how)
    no_curb = curb_group([{"X": 1e4, "Y": 1e4, "Z": 1e4} for _ in names], how)
    of_strips = polynomial_block(simulation.block, strips.strips, tuple(disturbed), sensors, no_curb)
    adjusted, count = jb.adjust(of_strips.block), len(of_strips.points)
    truth = np.asarray(simulation.truth.object_points)[of_strips.points]
    return adjusted, np.asarray(adjusted.block.object_points)[:count] - truth


def _true_places(simulation, strips) -> list[np.ndarray]:
    """Points and centres of each strip in its system."""
    truth = simulation.truth
    points, centres = np.asarray(truth.object_points), np.asarray(truth.exterior.projection_centre)
    return [
        (np.concatenate([points[strip.points], centres[strip.images]]) - frame.origin) @ frame.axes
        for strip, frame in zip(strips.strips, strips.frames, strict=True)
    ]


@pytest.mark.parametrize("degree", [2, 3])
def test_bent_strips_are_straightened(simulation, strips, degree):
    """Strips of exact coordinates, bent by polynomials of up to 20 m and disturbed by noise, come back to the noise."""
    how: tuple[Form, int] = "separate", degree
    rng = np.random.default_rng(degree)
    bends, bent = [], []
    for frame, there in zip(strips.frames, _true_places(simulation, strips), strict=True):
        c, x = rng.uniform(-20, 20, len(elements(*how))), there.copy()
        for _ in range(20):  # x + T(x) C is the true place
            x = there - np.stack(np.broadcast_arrays(*correction(*how, tuple(c), tuple(normalised(frame, x).T))), 1)
        bends.append(c)
        bent.append(x)
    adjusted, off = _adjusted(simulation, strips, how, bent)
    assert abs(float(adjusted.sigma0) - 1) < 3 / np.sqrt(2 * adjusted.redundancy)
    deviations = np.asarray(adjusted.standard_deviations.object_points)[: len(off)]
    assert np.sqrt(np.mean((off / deviations) ** 2)) == pytest.approx(1.0, abs=0.2)
    found, sd = np.asarray(adjusted.block.interior.elements), np.asarray(adjusted.standard_deviations.interior)
    assert np.sqrt(np.mean(((found - np.array(bends)) / sd) ** 2)) < 2.0


@pytest.mark.parametrize("degree", [2, 3])
def test_accumulated_errors_are_corrected_as_far_as_the_degree_allows(simulation, strips, degree):
    """Errors of scale and direction add up from model to model: the errors of coordinates are their double sums.

    What remains is at most twice what the best polynomial of the degree leaves of them, with the noise of the points.
    """
    rng = np.random.default_rng(0)
    bent, left, before = [], [], []
    for frame, there in zip(strips.frames, _true_places(simulation, strips), strict=True):
        x = there[:, 0] / frame.half_length
        ends = np.linspace(-1, 1, MODELS + 1)
        error = np.cumsum(np.cumsum(rng.normal(0, SIZE, (MODELS + 1, 3)), 0), 0)  # at the ends of the models
        of_points = np.stack([np.interp(x, ends, column) for column in error.T], 1)
        basis = np.vander(x, degree + 1)
        left.append(of_points - basis @ np.linalg.lstsq(basis, of_points, rcond=None)[0])
        before.append(of_points - of_points.mean(0))
        bent.append(there - of_points)
    adjusted, off = _adjusted(simulation, strips, ("separate", degree), bent)
    noise = np.asarray(adjusted.standard_deviations.object_points)[: len(off)] / float(adjusted.sigma0)
    remaining, allowed = np.sqrt(np.mean(off**2)), np.sqrt(np.mean(np.concatenate(left) ** 2) + np.mean(noise**2))
    assert remaining < 2 * allowed < 0.5 * np.sqrt(np.mean(np.concatenate(before) ** 2))


def test_plan_and_height(simulation):
    """The iteration converges by a factor of more than 10 per round, to within a few standard deviations."""
    found, simultaneous = jb.independent.plan_height(simulation.block), jb.independent.adjust_models(simulation.block)
    assert found.converged and (found.changes[1:-1] < 0.1 * found.changes[:-2]).all()
    sd = np.asarray(simultaneous.adjustment.standard_deviations.object_points)[: len(found.points)]
    difference = found.object_points - simultaneous.object_points
    assert np.sqrt(np.mean((difference / sd) ** 2)) < 1.0
