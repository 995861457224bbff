"""The points dealt to one, two and four devices: the same answer."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.block_variants import with_distances, with_private_cameras
from cases.one_step import step
from cases.simulated_blocks import long_block, small_block

from jaxbundle.block.block import Block
from jaxbundle.solve.adjust import adjust


@pytest.mark.parametrize("make", [with_distances, with_private_cameras], ids=["shared camera", "private cameras"])
def test_one_step_is_the_same(make: Callable[[Block], Block]) -> None:
    assert jax.local_device_count() == 4
    block = make(small_block().block)
    one, unknowns = step(block, 1)
    for devices in (2, 4):
        other, moved = step(block, devices)
        for name in ("cost", "reduction", "predicted", "moved"):
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
