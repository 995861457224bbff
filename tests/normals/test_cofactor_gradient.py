"""Transposed derivatives of cofactors and leverages by the engine are those of the whole matrix Q."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import PAIRS, case
from cases.block_variants import BLOCKS
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import attitude_derivatives, unknowns_of
from jaxbundle.normals.cofactors import cofactors
from jaxbundle.normals.from_block import problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.problem import OrderedUnknowns, Problem
from jaxbundle.solve import implicit_precision

CASES = {
    **{name: lambda name=name: BLOCKS[name](small_block(noise=1.0).block) for name in BLOCKS},
    **{name: lambda name=name: case(name) for name in PAIRS},
}


def gradients(block: Block, monkeypatch) -> list[tuple]:
    """Of all cofactors and leverages, with different weights: by the engine, and by the whole of Q."""
    centres = np.asarray(block.exterior.projection_centre)
    plan = plan_elimination(block.structure, block.groups, centres, 1)
    block = block.moved(-centres.mean(0))
    given = to_elimination_order(plan, unknowns_of(block)), problem(plan, block)
    o, matrix = given[1].observations, given[0].images.rotation
    turns = attitude_derivatives(matrix, o.in_angles, o.system)
    found = jax.eval_shape(cofactors, *given)
    found = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), found)

    def precision(given: tuple[OrderedUnknowns, Problem]) -> implicit_precision.Precision:
        q = implicit_precision.with_derivatives(found, *given, plan, block.structure, False)
        return implicit_precision.Precision(q.images, q.border, q.points, q.leverages)

    gradients = []
    for most in (0, 3000):
        monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", most)
        value, back = eqx.filter_vjp(precision, given)
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
    "name", [name if name in PAIRS else pytest.param(name, marks=pytest.mark.thorough) for name in CASES]
)
def test_gradient(name, monkeypatch):
    assert_equal(*gradients(CASES[name](), monkeypatch))
