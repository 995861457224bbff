"""Equations solved: H or N times the solution, by autodiff of all residuals in one piece, is the right side."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import case, drawn
from cases.block_variants import BLOCKS
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.cost import weighted_residuals
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors, problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.plan.reduced_plan import Method
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem
from jaxbundle.normals.solve_normals import solve_normals
from jaxbundle.numerics.compilation import QUICKLY
from jaxbundle.numerics.host import on_device
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.implicit import moved, zero_vector

compiled = partial(jax.jit, compiler_options=QUICKLY)


def residuals(d: NormalVector, x: OrderedUnknowns, p: Problem) -> list[jax.Array]:
    return weighted_residuals(moved(x, p, d), p)


def cost(d: NormalVector, x: OrderedUnknowns, p: Problem) -> jax.Array:
    return 0.5 * sum((jnp.sum(v * v) for v in residuals(d, x, p)), jnp.zeros(()))


def hessian(x: OrderedUnknowns, p: Problem, d: NormalVector) -> NormalVector:
    return jax.jvp(lambda e: jax.grad(cost)(e, x, p), (zero_vector(p),), (d,))[1]


def normals(x: OrderedUnknowns, p: Problem, d: NormalVector) -> NormalVector:
    _, along = jax.jvp(lambda e: residuals(e, x, p), (zero_vector(p),), (d,))
    return jax.vjp(lambda e: residuals(e, x, p), zero_vector(p))[1](along)[0]


def assert_solved(block: Block, devices: int, reduced: Method = "auto") -> None:
    """At the minimum of a block with errors of some sigmas, for a vector of the size of the standard deviations."""
    result = adjust(block, method="gauss-newton")
    block, sd, structure = result.block, result.standard_deviations, block.structure
    centres = np.asarray(block.exterior.projection_centre)
    plan = plan_elimination(structure, block.groups, centres, devices, reduced)
    block = block.moved(-centres.mean(0))
    x, p = to_elimination_order(plan, unknowns_of(block)), problem(plan, block)
    interior = np.asarray(sd.interior)[None, :, list(structure.interior_columns)]
    exterior = np.hstack([sd.projection_centre, sd.angles])[None]
    parameters, points = np.asarray(sd.parameters)[None], np.asarray(sd.object_points)[None]
    scale = jax.tree.map(
        on_device, ordered_vectors(plan, structure, BlockVectors(exterior, interior, parameters, points))
    )
    rng = np.random.default_rng(1)
    expected = jax.tree.map(lambda s: jnp.asarray(rng.standard_normal(s.shape[1:])) * s[0], scale)

    for product, exact in ((hessian, True), (normals, False)):
        right = jax.tree.map(lambda b: b[None], compiled(product)(x, p, expected))
        found = compiled(partial(solve_normals, exact=exact))(x, p, right)
        for d, known, s in zip(found, expected, scale, strict=True):
            np.testing.assert_allclose((d[0] - known) / np.where(s[0] == 0, 1.0, s[0]), 0.0, atol=1e-6)


def thorough(name: str) -> Any:
    """A case that another one of the default run is close to: shared cameras are solved on devices there."""
    return pytest.param(name, marks=pytest.mark.thorough)


@pytest.mark.parametrize("name", ["private cameras", thorough("shared camera"), thorough("two models")])
def test_solution(name):
    assert_solved(BLOCKS[name](small_block(noise=3.0).block), 1)


@pytest.mark.parametrize("name", ["geodetic and navigation", thorough("figures and correlated")])
def test_solution_with_observations_of_all_kinds(name):
    assert_solved(drawn(case(name), jax.random.key(1)), 1)


@pytest.mark.parametrize("name", ["shared camera", thorough("private cameras")])
def test_solution_by_conjugate_gradients(name):
    assert_solved(BLOCKS[name](small_block(noise=3.0).block), 1, "pcg")


def test_solution_on_devices():
    assert_solved(BLOCKS["shared camera"](small_block(noise=3.0).block), 4, "panels")
