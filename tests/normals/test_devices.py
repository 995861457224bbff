"""The points dealt to one, two and four devices: the same answer."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.block_variants import with_distances, with_private_cameras
from cases.one_step import step
from cases.simulated_blocks import long_block, small_block
from jaxtyping import Array

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.from_block import problem, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.problem import OrderedUnknowns
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.implicit_precision import _dense, free_places


@pytest.mark.parametrize(
    ("make", "devices"),
    [(with_distances, 4), (with_private_cameras, 2)],
    ids=["shared camera", "private cameras"],
)
def test_one_step_is_the_same(make: Callable[[Block], Block], devices: int) -> None:
    assert jax.local_device_count() == 4
    block = make(small_block().block)
    (one, unknowns), (other, moved) = (step(block, count) for count in (1, devices))
    for name in ("cost", "reduction", "predicted", "residual_change"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(unknowns), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * float(jnp.abs(b).max(initial=0.0)))


def test_the_adjustment_is_the_same() -> None:
    block = long_block().block
    one, four = (adjust(block, devices=devices, reduced="panels") for devices in (1, 4))
    np.testing.assert_allclose(four.sigma0, one.sigma0, rtol=1e-12)
    sd = one.standard_deviations
    for a, b in zip(four.standard_deviations, sd, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    off = np.abs(four.block.object_points - one.block.object_points)
    assert np.all(off <= 1e-6 * np.maximum(sd.object_points, 1e-9))


def held_angle(block: Block) -> Block:
    """One angle of an image is held, so that this image is corrected in the user's angles."""
    free = block.structure.exterior_free.copy()
    free[0, 4] = False
    return with_datum(dataclasses.replace(block, structure=dataclasses.replace(block.structure, exterior_free=free)))


def sums_of_cofactors(block: Block, devices: int) -> tuple[list[float], list[float]]:
    """Sums of cofactors and leverages by the whole matrix, and their derivatives where all unknowns change alike."""
    block = block.moved(-np.mean(np.asarray(block.exterior.projection_centre), 0))
    structure = block.structure
    plan = plan_elimination(structure, block.groups, None, devices, "panels")
    x, p = to_elimination_order(plan, unknowns_of(block)), problem(plan, block)
    free = free_places(plan, structure)
    moved = jax.tree.map(jnp.ones_like, x)

    def sums(x: OrderedUnknowns) -> list[Array]:
        return [jnp.sum(part) for part in jax.tree.leaves(_dense(x, p, free, optimised=False))]

    found = jax.jit(lambda x: jax.jvp(sums, (x,), (moved,)))(x)
    values, derivatives = ([float(number) for number in numbers] for numbers in found)
    return [*values[:3], sum(values[3:])], [*derivatives[:3], sum(derivatives[3:])]


def test_derivatives_of_the_whole_cofactor_matrix_are_the_same() -> None:
    block = held_angle(simulate(1, 3, points_per_image=8, seed=3).block)
    for one, two in zip(sums_of_cofactors(block, 1), sums_of_cofactors(block, 2), strict=True):
        assert np.isfinite(two).all() and np.abs(one).max() > 0
        np.testing.assert_allclose(two, one, rtol=1e-8, atol=1e-10 * np.abs(one).max())


@pytest.mark.parametrize("devices", [-1, 5])
def test_devices_that_are_not_there(devices: int) -> None:
    with pytest.raises(ValueError, match="JAX has 4"):
        adjust(small_block().block, devices=devices)
