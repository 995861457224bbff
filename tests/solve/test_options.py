"""The options of an adjustment are one object: it keeps them, and whatever adjusts again takes them from it."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.shuffled import shuffled
from cases.simulated_blocks import small_block
from jaxtyping import Array

import jaxbundle as jb
from jaxbundle.solve import adjust as solve_adjust, batch
from jaxbundle.solve.options import Choices
from jaxbundle.solve.stopping_rules import UnknownRule
from jaxbundle.statistics import components, snooping

pytestmark = pytest.mark.xdist_group("options")
ALL: Choices = {  # every option, none of them as by default
    "method": "gauss-newton",
    "stop": jb.stopping.PointRule(1e-5),
    "max_iterations": 40,
    "precision": True,
    "engine": "block",
    "reduced": "panels",
    "devices": 2,
    "robust": None,
    "derivatives": "gauss-newton",
}


@pytest.fixture(scope="module")
def block() -> jb.Block:
    return small_block().block


@pytest.fixture(scope="module")
def result(block: jb.Block) -> jb.Adjustment:
    return jb.adjust(block, **ALL)


@pytest.fixture(scope="module")
def robust(block: jb.Block) -> jb.Adjustment:
    """Of a block with some gross errors, so that its weights are not those given."""
    rays = np.array(block.rays.coordinates)
    rays[::17] += 30 * np.asarray(block.rays.sigmas)[::17]
    return jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(rays)), robust=jb.robust.Huber())


def four_unknowns(block: jb.Block) -> UnknownRule:
    """The rule of the tests of stopping rules, whose program serves here too."""
    names = ("1_01", "X0"), ("1_02", "omega"), ("camera", "x0"), ("20", "Z")
    return jb.stopping.unknown_rule(block, 1e-3, *names)


def test_keywords_and_fields_are_the_same():
    names = [field.name for field in dataclasses.fields(jb.Options)]
    assert names == list(ALL) == list(Choices.__annotations__)
    documented = inspect.getdoc(jb.adjust) or ""
    assert not [name for name in names if f"{name}: " not in documented]


def test_an_adjustment_keeps_them(result: jb.Adjustment):
    assert eqx.tree_equal(result.options, jb.Options(**ALL))
    assert (result.method, result.stopping_rule, result.reduced) == ("gauss-newton", "points", "panels")


def test_they_are_taken_over_and_single_ones_changed(block: jb.Block, result: jb.Adjustment):
    again = jb.adjust(block, result.options, max_iterations=1)
    assert again.status.name == "MAXIMUM_ITERATIONS" and int(again.iterations.trials) == 1
    assert again.method == "gauss-newton" and again.stopping_rule == "points"
    assert eqx.tree_equal(dataclasses.replace(again.options, max_iterations=40), result.options)


def test_a_robust_adjustment_keeps_its_weight_function(robust: jb.Adjustment):
    assert eqx.tree_equal(robust.options.robust, jb.robust.Huber())


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[jb.Options]:
    """The options of all adjustments that are made."""
    calls: list[jb.Options] = []

    def watched(block: jb.Block, options: jb.Options | None = None, **others) -> jb.Adjustment:
        assert options is not None
        calls.append(options)
        return solve_adjust.adjust(block, options, **others)

    for module in (snooping, components, batch):
        monkeypatch.setattr(module, "adjust", watched)
    return calls


def test_snooping_keeps_them(block: jb.Block, given: list[jb.Options]):
    rays = np.array(block.rays.coordinates)
    rays[40] += 40 * np.asarray(block.rays.sigmas)[40]
    spoilt = eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(rays))
    start = jb.adjust(spoilt, stop=four_unknowns(spoilt), max_iterations=40, derivatives="gauss-newton")
    found = jb.snoop(start)
    assert found.removed and len(given) == len(found.removed)
    assert all(eqx.tree_equal(options, start.options) for options in given)
    assert start.options.max_iterations == 40 and found.adjustment.stopping_rule == "unknown"


def test_variance_components_keep_them(block: jb.Block, result: jb.Adjustment, given: list[jb.Options]):
    found = jb.statistics.variance_components(block, options=result.options, tolerance=0.1)
    assert len(given) == found.rounds + 1
    assert all(eqx.tree_equal(options, result.options) for options in given)


def test_many_adjustments_keep_them(block: jb.Block, result: jb.Adjustment, given: list[jb.Options]):
    found = jb.adjust_many([block], result.options, max_iterations=30)
    assert [options.max_iterations for options in given] == [30]
    assert found.adjustments[0].options.derivatives == "gauss-newton"


def test_the_rule_of_one_block_serves_another(block: jb.Block):
    """A rule by names or by pairs of rays holds no numbers of the block it was made for."""
    other = shuffled(block, np.random.default_rng(3))[0]
    for rule in (jb.stopping.parallax_rule(block, 1e-7), four_unknowns(block)):
        assert not jax.tree.leaves(rule)
        assert jb.adjust(other, stop=rule, precision=False).trustworthy


def test_wrong_options_are_told(block: jb.Block, unchecked_types):
    with pytest.raises(TypeError, match="adjust has no option 'methods'; there are method, stop, max_iterations"):
        jb.adjust(block, methods="gauss-newton")  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError, match="adjust takes Options, not str"):
        jb.adjust(block, "gauss-newton")  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=r"a stopping rule, such as jb.stopping.AngleRule\(\), not 'angle'"):
        jb.Options(stop="angle")  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=r"a weight function, such as jb.robust.Huber\(\), not 'huber'"):
        jb.Options(robust="huber")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="no method 'newton'"):
        jb.Options(method="newton")


def test_an_adjustment_with_its_options_goes_through_jit_and_vmap(block: jb.Block):
    block = jb.blocks.with_datum(block)

    def adjusted(xy: Array) -> jb.Adjustment:
        return jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, xy), precision=False)

    both = jax.jit(jax.vmap(adjusted))(jnp.stack([block.rays.coordinates] * 2))
    with pytest.raises(ValueError, match="these are 2 adjustments of vmap"):
        _ = both.trustworthy
    alone = jax.tree.map(lambda x: x[0], both)
    assert alone.trustworthy and eqx.tree_equal(alone.options, jb.Options(precision=False))


@pytest.mark.parametrize("name", ["status", "trustworthy", "verdict"])
def test_a_traced_adjustment_tells_no_status(block: jb.Block, name: str):
    block = jb.blocks.with_datum(block)

    def asked(xy: Array) -> Array:
        found = jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, xy), precision=False)
        return found.sigma0 if getattr(found, name) else jnp.zeros(())

    with pytest.raises(ValueError, match="unknown inside jit, grad and vmap: read it outside"):
        jax.eval_shape(asked, block.rays.coordinates)


def test_statistics_have_the_weights_of_the_last_round(robust: jb.Adjustment):
    """By every way: standard deviations, functions of the unknowns, ellipses, redundancy numbers, detectable errors."""
    assert robust.reweighting is not None and (np.asarray(robust.reweighting.weights) < 0.5).sum() > 5
    weighted = robust.weighted_block
    np.testing.assert_array_equal(robust.block.rays.coordinates, weighted.rays.coordinates)
    plain = jb.adjust(weighted)
    np.testing.assert_allclose(plain.sigma0, robust.sigma0, rtol=1e-6)
    sd = np.asarray(robust.standard_deviations.object_points)
    points = np.arange(10, 14)
    found = jb.covariance_of(robust, lambda b: b.object_points[points])
    np.testing.assert_allclose(found.standard_deviations, sd[points], rtol=1e-7)
    ellipsoids = jb.statistics.error_ellipsoids(robust)
    np.testing.assert_allclose(np.sum(ellipsoids.semi_axes**2, 1), np.sum(sd**2, 1), rtol=1e-9)
    ours, theirs = jb.statistics.reliability(robust), jb.statistics.reliability(plain)
    for name in ("redundancy_numbers", "minimal_detectable", "external"):
        for a, b in zip(getattr(ours, name), getattr(theirs, name), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6, err_msg=name)
    ratios, of_plain = jb.statistics.control_influence(robust), jb.statistics.control_influence(plain)
    np.testing.assert_allclose(ratios.together.largest, of_plain.together.largest, rtol=1e-5)


def test_the_weighted_block_of_least_squares_is_the_block(result: jb.Adjustment):
    assert result.weighted_block is result.block
