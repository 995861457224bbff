"""Transposed derivatives of cofactors and leverages by the engine are those of the whole matrix Q."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import case, strip
from cases.block_variants import BLOCKS
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import attitude_derivatives, unknowns_of
from jaxbundle.normals.cofactors import cofactors
from jaxbundle.normals.from_block import problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import EliminationPlan, plan_elimination
from jaxbundle.normals.problem import OrderedUnknowns, Problem
from jaxbundle.solve import implicit_precision

CASES = {
    "all forms": lambda: case("all forms"),
    "strip": strip,
    "private cameras": lambda: BLOCKS["private cameras"](small_block(noise=1.0).block),
}


class Given(NamedTuple):
    """Cofactors as a function of unknowns and observations; `plan`: where the images of the block are."""

    at: tuple[OrderedUnknowns, Problem]
    plan: EliminationPlan
    precision: Callable[[tuple[OrderedUnknowns, Problem]], implicit_precision.Precision]


def given(block: Block, devices: int) -> Given:
    """Values of the cofactors do not enter into their derivatives."""
    centres = np.asarray(block.exterior.projection_centre)
    plan = plan_elimination(block.structure, block.groups, centres, devices)
    block = block.moved(-centres.mean(0))
    at = to_elimination_order(plan, unknowns_of(block)), problem(plan, block)
    found = jax.eval_shape(cofactors, *at)
    found = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), found)

    def precision(at: tuple[OrderedUnknowns, Problem]) -> implicit_precision.Precision:
        q = implicit_precision.with_derivatives(found, *at, plan, block.structure, False)
        return implicit_precision.Precision(q.images, q.border, q.points, q.leverages)

    return Given(at, plan, precision)


def gradients(block: Block, devices: int, monkeypatch) -> list[tuple]:
    """Of all cofactors and leverages, with different weights: by the engine, and by the whole of Q."""
    at, plan, precision = given(block, devices)
    o, matrix = at[1].observations, at[0].images.rotation
    turns = attitude_derivatives(matrix, o.in_angles, o.system)
    gradients = []
    for most in (0, 3000):
        monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", most)
        value, back = eqx.filter_vjp(precision, at)
        weights = jax.tree.map(lambda q: jnp.cos(1.0 + jnp.arange(q.size, dtype=float)).reshape(q.shape), value)
        by_unknowns, by_problem = back(weights)[0]
        # of the nine elements of a matrix only what turns it; of the images only those of the block
        images = by_unknowns.images
        turned = jnp.einsum("eai,ei->ai", turns, images.rotation)[:, plan.order.image]
        centre = images.centre[:, plan.order.image]
        gradients.append((turned, centre, images.interior, images.points, by_unknowns.tiles, by_problem))
    return gradients


def assert_equal(one: tuple, other: tuple) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if a.size:
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9 * float(np.abs(np.asarray(b)).max()))


@pytest.mark.parametrize(
    ("name", "devices"),
    [
        ("strip", 1),
        *(
            pytest.param(name, count, marks=pytest.mark.thorough)
            for name, count in (("all forms", 1), ("all forms", 2), ("private cameras", 1))
        ),
    ],
)
def test_gradient(name, devices, monkeypatch):
    assert_equal(*gradients(CASES[name](), devices, monkeypatch))


def test_second_derivatives_by_the_engine_are_refused(monkeypatch):
    monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", 0)
    at, _, precision = given(strip(), 1)

    def scatter(factor: jax.Array) -> jax.Array:
        scaled = eqx.tree_at(lambda at: at[0].tiles, at, factor * at[0].tiles)
        return jnp.sum(precision(scaled).points)

    with pytest.raises(ValueError, match=r"have no second derivatives: call adjust\(\.\.\., precision=False\)"):
        jax.eval_shape(jax.grad(jax.grad(scatter)), jnp.ones(()))
