"""The points dealt to one, two and four devices: the same answer."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from simulated import long_block, small_block
from test_elimination import with_distances, with_private_cameras

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.from_block import problem, to_block_order, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.step import trial_step
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.solve.adjust import adjust

compiled_step = Compiled(trial_step)


def step(block: Block, devices: int):
    """Reductions and unknowns of one step."""
    block = block.moved(-np.mean(block.exterior.projection_centre, 0))
    plan = plan_elimination(
        block.structure, block.groups, np.asarray(block.exterior.projection_centre), devices, "panels"
    )
    start = to_elimination_order(plan, unknowns_of(block))
    trial = compiled_step(start, problem(plan, block), jnp.array(1e-3), optimised=False)
    return trial, to_block_order(plan, trial.unknowns)


@pytest.mark.parametrize("make", [with_distances, with_private_cameras], ids=["shared camera", "private cameras"])
def test_one_step_is_the_same(make: Callable[[Block], Block]) -> None:
    assert jax.local_device_count() == 4
    block = make(small_block().block)
    one, unknowns = step(block, 1)
    for devices in (2, 4):
        other, moved = step(block, devices)
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


@pytest.mark.parametrize("devices", [-1, 5])
def test_devices_that_are_not_there(devices: int) -> None:
    with pytest.raises(ValueError, match="JAX has 4"):
        adjust(small_block().block, devices=devices)
