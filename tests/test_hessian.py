"""Equations with all second derivatives: H times the solution, H by autodiff of the whole sum, is the right side."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from simulated import small_block
from test_elimination import BLOCKS, with_distances

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.arrange import arrange, arranged_unknowns, problem
from jaxbundle.normals.hessian import solve_hessian
from jaxbundle.normals.step import weighted_residuals
from jaxbundle.normals.vector import NormalVector, arranged_vectors
from jaxbundle.numerics.compilation import QUICKLY
from jaxbundle.numerics.host import on_device
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.implicit import moved, zero_vector

compiled = partial(jax.jit, compiler_options=QUICKLY)


def assert_solved(block: Block, devices: int) -> None:
    """At the minimum of a block with errors of some sigmas, for a vector of the size of the standard deviations."""
    result = adjust(block)
    block, sd, structure = result.block, result.standard_deviations, block.structure
    centres = np.asarray(block.exterior.projection_centre)
    plan = arrange(structure, block.groups, centres, devices, "panels" if devices > 1 else "auto")
    block = block.moved(-centres.mean(0))
    x, p = arranged_unknowns(plan, unknowns_of(block)), problem(plan, block)
    interior = np.asarray(sd.interior)[None, :, list(structure.interior_columns)]
    exterior = np.hstack([sd.projection_centre, sd.angles])[None]
    parameters, points = np.asarray(sd.parameters)[None], np.asarray(sd.object_points)[None]
    scale = NormalVector(*map(on_device, arranged_vectors(plan, structure, exterior, interior, parameters, points)))
    rng = np.random.default_rng(1)
    expected = jax.tree.map(lambda s: jnp.asarray(rng.standard_normal(s.shape[1:])) * s[0], scale)

    def cost(d: NormalVector) -> jax.Array:
        return 0.5 * sum((jnp.sum(v * v) for v in weighted_residuals(moved(x, p, d), p)), jnp.zeros(()))

    right = compiled(lambda d: jax.jvp(jax.grad(cost), (zero_vector(p),), (d,))[1])(expected)
    found = compiled(solve_hessian)(x, p, right)
    for d, known, s in zip(found, expected, scale, strict=True):
        np.testing.assert_allclose((d - known) / np.where(s[0] == 0, 1.0, s[0]), 0.0, atol=1e-6)


@pytest.mark.parametrize("name", BLOCKS)
def test_solution(name):
    assert_solved(BLOCKS[name](small_block(noise=3.0).block), 1)


def test_solution_on_devices():
    assert_solved(with_distances(small_block(noise=3.0).block), 4)
