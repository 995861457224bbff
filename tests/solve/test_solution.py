"""Equations solved: H or N times the solution, by autodiff of all residuals in one piece, is the right side."""

from functools import partial

import jax
import numpy as np
import pytest
from cases.all_observations import case, drawn
from cases.block_variants import BLOCKS
from cases.dense_adjustment import centred, dense_system, hessian_product, masks
from cases.simulated_blocks import small_block
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.from_block import BlockVectors, ordered_vectors, problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.plan.reduced_plan import Method
from jaxbundle.normals.solve_normals import solve_normals
from jaxbundle.numerics.compilation import QUICKLY
from jaxbundle.numerics.host import on_device
from jaxbundle.solve.adjust import adjust


@pytest.fixture(scope="module")
def minimum():
    """Adjusted blocks, each adjusted once: with errors of some sigmas, so that second derivatives count."""
    made: dict[str, Block] = {}

    def of(name: str) -> Block:
        if name not in made:
            everything = name == "all observations"
            block = drawn(case(name), jax.random.key(1)) if everything else BLOCKS[name](small_block(noise=3.0).block)
            made[name] = adjust(block, method="levenberg-marquardt" if everything else "gauss-newton").block
        return made[name]

    return of


def of_elements(flat: Float[np.ndarray, " free"], o: Observations) -> BlockVectors:
    """A vector of the free corrections as one of all elements."""
    fields, first = [], 0
    for mask in masks(o):
        field = np.zeros(mask.shape)
        field[mask] = flat[first : first + mask.sum()]
        fields.append(field.T[None])
        first += int(mask.sum())
    return BlockVectors(*fields)


def assert_solved(block: Block, devices: int, reduced: Method, exact: bool) -> None:
    """For a vector of the size of the standard deviations."""
    unknowns, o = centred(block)
    design = dense_system(unknowns, o).design
    lengths = np.linalg.norm(design, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(design / lengths, mode="r")) / lengths[:, None]
    sd = np.linalg.norm(inverse, axis=1)
    expected = np.random.default_rng(1).standard_normal(len(sd)) * sd
    right = hessian_product(unknowns, o, expected) if exact else design.T @ (design @ expected)

    centres, structure = np.asarray(block.exterior.projection_centre), block.structure
    plan = plan_elimination(structure, block.groups, centres, devices, reduced)
    moved = block.moved(-centres.mean(0))
    x, p = to_elimination_order(plan, unknowns_of(moved)), problem(plan, moved)
    b, known, scale = (ordered_vectors(plan, structure, of_elements(v, o)) for v in (right, expected, sd))
    solve = jax.jit(partial(solve_normals, exact=exact), compiler_options=QUICKLY)
    for d, k, s in zip(solve(x, p, jax.tree.map(on_device, b)), known, scale, strict=True):
        np.testing.assert_allclose((d[0] - k[0]) / np.where(s[0] == 0, 1.0, s[0]), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "exact"),
    [
        ("shared cameras", True),
        *(
            pytest.param(name, exact, marks=pytest.mark.thorough)
            for name, exact in (("shared cameras", False), ("private cameras", True), ("all observations", True))
        ),
    ],
)
def test_solution(minimum, name, exact):
    assert_solved(minimum(name), 1, "auto", exact)


@pytest.mark.parametrize(
    ("name", "exact"),
    [
        ("shared cameras", False),
        *(
            pytest.param(name, exact, marks=pytest.mark.thorough)
            for name, exact in (("shared cameras", True), ("private cameras", True), ("private cameras", False))
        ),
    ],
)
def test_solution_by_conjugate_gradients(minimum, name, exact):
    assert_solved(minimum(name), 1, "pcg", exact)


@pytest.mark.parametrize("exact", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_solution_on_devices(minimum, exact):
    assert_solved(minimum("shared cameras"), 4, "panels", exact)
