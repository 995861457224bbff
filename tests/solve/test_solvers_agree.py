"""Four solvers and four stopping rules end at the same minimum."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from cases.dense_adjustment import centred, dense_system, free_count, moved, residual_vector
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block, ExteriorOrientation, InteriorOrientation
from jaxbundle.block.datum import with_datum
from jaxbundle.block.unknowns import Unknowns, angles_near
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.stopping_rules import AngleRule, PointRule, parallax_rule, unknown_rule


@pytest.fixture(scope="module")
def block() -> Block:
    return small_block().block


@pytest.fixture(scope="module")
def reference(block) -> Adjustment:
    return adjust(block)


def off(found: Block, reference: Adjustment) -> float:
    """Largest difference of an unknown from the reference, in standard deviations."""
    expected, sd = reference.block, reference.standard_deviations
    differences = (
        (found.exterior.projection_centre - expected.exterior.projection_centre, sd.projection_centre),
        (found.exterior.angles - expected.exterior.angles, sd.angles),
        (found.interior.elements - expected.interior.elements, sd.interior),
        (found.object_points - expected.object_points, sd.object_points),
    )
    return max(float(jnp.max(jnp.abs(jnp.where(s > 0, d / jnp.where(s > 0, s, 1.0), 0.0)))) for d, s in differences)


def with_unknowns(block: Block, unknowns: Unknowns) -> Block:
    """The block with these values in place of its own."""
    elements = block.interior.elements.shape[1]
    angles = angles_near(tuple(unknowns.rotation), block.exterior.angles.T, block.structure.rotation_system)
    return eqx.tree_at(
        lambda b: (b.exterior, b.interior, b.parameters, b.object_points),
        block,
        (
            ExteriorOrientation(unknowns.centre.T, jnp.stack(angles, -1)),
            InteriorOrientation(unknowns.interior[:elements].T),
            unknowns.parameters,
            unknowns.points.T,
        ),
    )


@pytest.mark.parametrize("method", ["levenberg-marquardt", "gauss-newton"])
@pytest.mark.parametrize("engine", ["block", "jaxopt"])
def test_engines_and_methods(block, reference, engine, method):
    found = adjust(block, method=method, engine=engine)
    assert found.trustworthy and found.method == method
    # a residual is rounded to some 1e-11 sigma (100 mm in float64 over 0.005 mm), 650 of them change v^T P v by 3e-10
    assert float(found.vtpv) == pytest.approx(float(reference.vtpv), abs=1e-9)
    assert off(found.block, reference) < 1e-6
    iterations = found.iterations
    assert float(iterations.initial_cost) == pytest.approx(float(reference.iterations.initial_cost), rel=1e-12)
    assert 2 * float(iterations.final_cost) == pytest.approx(float(reference.vtpv), abs=1e-9)
    assert 0 < int(iterations.accepted) <= int(iterations.trials) < 30


def test_stock_levenberg_marquardt_of_optimistix(block, reference):
    """On the flat vector of all corrections, in units of the columns of the design matrix."""
    unknowns, observations = centred(block)
    lengths = jnp.asarray(dense_system(unknowns, observations).lengths)
    solver = optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9)

    def residuals(x, _):
        return residual_vector(unknowns, observations, x / lengths)

    def solve(start):
        return optx.least_squares(residuals, solver, start, max_steps=100, throw=False).value

    x = jax.jit(solve)(jnp.zeros(free_count(observations)))
    origin = jnp.mean(block.exterior.projection_centre, 0)
    found = with_unknowns(block.moved(-origin), moved(unknowns, observations, x / lengths)).moved(origin)
    assert float(jnp.sum(residuals(x, None) ** 2)) == pytest.approx(float(reference.vtpv), abs=1e-9)
    assert off(found, reference) < 1e-5


RULES = {
    "angle": lambda block: AngleRule(limit=1e-3),
    "points": lambda block: PointRule(limit=0.05),  # m
    "parallax": lambda block: parallax_rule(block, 1e-7),  # of the principal distance
    "unknown": lambda block: unknown_rule(
        block, 1e-3, ("1_01", "X0"), ("1_02", "omega"), ("camera", "x0"), ("20", "Z")
    ),
}


@pytest.mark.parametrize("name", RULES)
def test_stopping_rules(block, reference, name):
    """Each ends the solve by its own measure, sooner than the strict default, and is named in the result."""
    rule = RULES[name](block)
    found = adjust(block, stop=rule, precision=False)
    assert found.stopping_rule == name and name in found.summary()
    assert found.status is Status.CONVERGED
    assert float(found.iterations.measure) <= rule.limit
    assert int(found.iterations.trials) < int(reference.iterations.trials)
    assert off(found.block, reference) < 0.05


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_unknown_names_are_refused(block):
    with pytest.raises(ValueError, match="K9 of camera"):
        unknown_rule(block, 1e-6, ("camera", "K9"))
    for method, engine in (("newton", "block"), ("gauss-newton", "ceres")):
        with pytest.raises(ValueError, match="levenberg-marquardt.*gauss-newton.*jaxopt"):
            adjust(block, method=method, engine=engine)


def test_too_few_iterations_are_told(block):
    for engine in ("block", "jaxopt"):
        found = adjust(block, max_iterations=2, engine=engine, precision=False)
        assert found.status is Status.MAXIMUM_ITERATIONS and not found.trustworthy
        assert int(found.iterations.trials) == 2
        assert "not converged" in found.summary()


def test_second_opinion_is_for_small_blocks():
    block = simulate(2, 6, points_per_image=600).block
    with pytest.raises(ValueError, match=f"limited to 3000 unknowns; the block has {block.structure.n_unknowns}"):
        adjust(block, engine="jaxopt")
    arrays, static = eqx.partition(with_datum(small_block().block), eqx.is_array)
    with pytest.raises(ValueError, match="does not work inside jit"):
        jax.jit(lambda arrays: adjust(eqx.combine(arrays, static), engine="jaxopt").sigma0)(arrays)


def test_gauss_newton_says_when_it_diverges(block):
    """From images turned upside down no full step leads back."""
    angles = block.exterior.angles + np.array([[2.0, 1.0, 0.5]])
    found = adjust(eqx.tree_at(lambda b: b.exterior.angles, block, angles), method="gauss-newton", max_iterations=30)
    assert found.status is not Status.CONVERGED
