"""A structure is planned once: robust rounds, statistics and a user's own loop plan nothing again."""

import dataclasses
import gc
import weakref
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.simulated_blocks import small_block
from jaxtyping import Array

import jaxbundle as jb
from jaxbundle.block.block import Block
from jaxbundle.normals.plan import known_plans
from jaxbundle.planning.simulation import simulate

pytestmark = pytest.mark.xdist_group("planned_once")


@pytest.fixture
def count(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Devices of every plan that is made."""
    made: list[int] = []
    plan_elimination = known_plans.plan_elimination

    def counted(structure, groups, centres, devices, *rest, **options):
        made.append(devices)
        return plan_elimination(structure, groups, centres, devices, *rest, **options)

    monkeypatch.setattr(known_plans, "plan_elimination", counted)
    return made


def shifted(block: Block) -> Block:
    return eqx.tree_at(lambda b: b.object_points, block, block.object_points + 0.01 * block.structure.point_free)


@pytest.mark.parametrize("make", [lambda: small_block().block, lambda: free_block()], ids=["control", "minimal"])
def test_an_adjustment_of_other_values_plans_nothing(make, count: list[int]):
    block = make()
    one = jb.adjust(block)
    two = jb.adjust(shifted(block))
    three = jb.adjust(one.block, precision=False)
    assert count == [1]
    assert one.block.structure is two.block.structure is three.block.structure
    np.testing.assert_allclose(two.sigma0, one.sigma0, rtol=1e-9)


def free_block() -> Block:
    block = simulate(1, 3, points_per_image=20, seed=3).block
    structure = dataclasses.replace(block.structure, point_free=np.ones_like(block.structure.point_free))
    return dataclasses.replace(block, structure=structure, groups=())


def test_robust_rounds_and_statistics_plan_nothing_again(count: list[int]):
    block = small_block().block
    rays = np.array(block.rays.coordinates)
    rays[::25] += 20 * np.asarray(block.rays.sigmas)[::25]
    result = jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(rays)), robust=jb.robust.Huber())
    assert result.reweighting is not None and result.reweighting.rounds > 2
    jb.covariance_of(result, lambda b: b.object_points[3])
    jb.statistics.variance_components(block, tolerance=0.1)
    assert count == [1]


def test_a_plan_made_under_tracing_serves_outside(count: list[int]):
    block = jb.blocks.with_datum(small_block().block)

    def sigma0(xy: Array) -> Array:
        return jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, xy), precision=False).sigma0

    jax.eval_shape(sigma0, block.rays.coordinates)
    plan = known_plans._PLANS[block.structure][0].plan
    lists = plan.reduced.panels, [part.pairs for part in plan.parts]
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(lists))
    jb.adjust(block, precision=False)
    assert count == [1]


def test_what_the_plan_depends_on_is_planned_anew(count: list[int]):
    block = jb.adjust(small_block().block, precision=False).block
    structure = block.structure
    plan = partial(known_plans.planned, centres=np.asarray(block.exterior.projection_centre), direct=False)
    known = plan(structure, block.groups, devices=1)
    assert count == [1]  # that of the adjustment
    plan(structure, block.groups, devices=2, solver="panels")
    assert count == [1, 2]
    plan(structure, block.groups[:1], devices=1)
    plan(dataclasses.replace(structure), block.groups, devices=1)
    assert count == [1, 2, 1, 1]
    assert plan(structure, block.groups, devices=1) is known
    assert count == [1, 2, 1, 1]


def test_a_plan_goes_with_its_structure():
    block = small_block().block
    result = jb.adjust(block, precision=False)
    structure, derived = weakref.ref(block.structure), weakref.ref(result.block.structure)
    plan = weakref.ref(known_plans._PLANS[result.block.structure][0].plan)
    assert plan() is not None and derived() is not structure()
    del block, result
    gc.collect()
    assert structure() is None and derived() is None and plan() is None
