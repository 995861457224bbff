"""Points on more images than an ordinary tile has slots are eliminated like all others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.block_variants import with_private_cameras
from cases.dense_adjustment import centred, dense_cofactors, dense_step, dense_system, difference, free_values, sizes
from cases.dense_steps import block_steps
from cases.long_tracks import block_of
from cases.one_step import step

from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.plan.tiling import SLOTS
from jaxbundle.solve.adjust import adjust

INTERIOR = ("principal_distance", "x0", "y0")
DAMPINGS = (1e-12, 1e-2)


def mixed_tracks(images: int, seed: int = 1) -> list[np.ndarray]:
    """Points on nearly all images, on 49 to 64 neighbouring ones, and on few: tiles of 64, 96 and 128 slots."""
    rng = np.random.default_rng(seed)
    tracks = [np.flatnonzero(rng.random(images) < 0.95) for _ in range(4)]
    for _ in range(20):
        length = rng.integers(SLOTS + 1, 65)
        first = rng.integers(0, images - length)
        tracks.append(first + np.arange(length))
    for _ in range(40):
        first = rng.integers(0, images - 8)
        tracks.append(first + np.flatnonzero(rng.permutation(8) < 4))
    return [tracks[k] for k in rng.permutation(len(tracks))]


BLOCKS = {
    "shared camera": lambda: block_of(mixed_tracks(100), 100, INTERIOR),
    "private cameras": lambda: with_private_cameras(block_of(mixed_tracks(100), 100, INTERIOR)),
    "fewer images": lambda: block_of(mixed_tracks(70), 70, INTERIOR),
}


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("fewer images", "panels"),
        pytest.param("shared camera", "panels", marks=pytest.mark.thorough),
        pytest.param("private cameras", "dense", marks=pytest.mark.thorough),
        pytest.param("private cameras", "pcg", marks=pytest.mark.thorough),
    ],
)
def test_steps(name, method):
    block = BLOCKS[name]()
    unknowns, observations = centred(block)
    system = dense_system(unknowns, observations)
    steps = [dense_step(system, damping) for damping in DAMPINGS]
    assert len(system.lengths) == block.structure.n_unknowns
    rounding = np.finfo(float).eps * np.linalg.norm(system.lengths * sizes(unknowns, observations))
    for damping, dense, stepped in zip(DAMPINGS, steps, block_steps(block, DAMPINGS, method, 1), strict=True):
        off = difference(unknowns, stepped, observations) - dense
        assert np.linalg.norm(system.lengths * off) < 1e-10 * np.linalg.norm(system.lengths * dense) + rounding, damping


@pytest.mark.thorough
def test_converges_with_the_standard_deviations_of_the_dense_equations():
    adjustment = adjust(BLOCKS["shared camera"]())
    assert adjustment.trustworthy
    unknowns, observations = centred(adjustment.block)
    dense = float(adjustment.sigma0) * np.sqrt(np.diagonal(dense_cofactors(unknowns, observations)))
    sd = adjustment.standard_deviations
    found = free_values(
        sd.projection_centre.T, sd.angles.T, sd.interior.T, sd.parameters, sd.object_points.T, observations
    )
    np.testing.assert_allclose(found, dense, rtol=1e-9)
    assert adjustment.redundancy_numbers is not None
    numbers = sum(float(r.sum()) for r in adjustment.redundancy_numbers)
    np.testing.assert_allclose(numbers, adjustment.redundancy, rtol=1e-9)


@pytest.mark.thorough
def test_two_devices_take_the_same_step():
    block = BLOCKS["shared camera"]()
    one, unknowns = step(block, 1)
    other, moved = step(block, 2)
    for name in ("cost", "reduction", "predicted", "residual_change"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(unknowns), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * float(jnp.abs(b).max(initial=0.0)))


@pytest.mark.thorough
def test_a_point_on_every_one_of_many_images():
    """A strip with one such point, whose elimination makes the reduced matrix full."""
    images, rng = 300, np.random.default_rng(2)
    tracks = [i + np.flatnonzero(rng.permutation(6) < 4) for i in range(images - 5) for _ in range(2)]
    block = block_of([*tracks, np.arange(images)], images, ())
    trial, _ = step(block, 2)
    assert trial.finite
    assert float(trial.reduction) == pytest.approx(float(trial.predicted), rel=0.01)


@pytest.mark.parametrize(
    ("tracks", "slots"),
    [
        ([range(3), range(SLOTS)], [SLOTS]),
        ([range(SLOTS + 1), range(3)], [SLOTS, 64]),
        ([range(SLOTS + 1), range(20, 100)], [96]),
        ([*[range(100)] * 3, *[range(k, k + 55) for k in range(45)]], [128]),
    ],
    ids=["short", "both", "long", "many"],
)
@pytest.mark.parametrize("devices", [1, 2])
def test_every_ray_has_one_cell(tracks, slots, devices, monkeypatch):
    """And there are chunks of long tracks only where there are long tracks."""
    monkeypatch.setattr("jaxbundle.normals.plan.incidence.BORDER_SHARE", 0.0)
    block = block_of([np.array(track) for track in tracks], 100, ())
    structure = block.structure
    plan = plan_elimination(structure, block.groups, np.asarray(block.exterior.projection_centre), devices)
    assert [part.tiling.slot_image.shape[2] for part in plan.parts] == slots
    assert len(plan.border_points) == 0
    assert len(np.unique(plan.order.point)) == len(tracks) and plan.order.point.max() < plan.tile_points
    found, total = [], sum(part.tiling.tiles for part in plan.parts)
    for part in plan.parts:
        tiling = part.tiling
        device, chunk, slot, column = np.nonzero(tiling.ray >= 0)
        ray = part.rays[tiling.ray[device, chunk, slot, column]]
        assert np.all(chunk < tiling.chunks[device])
        place = (device * total + tiling.slot_tile[device, chunk, slot]) * plan.layout.width + column
        np.testing.assert_array_equal(place, plan.order.point[structure.ray_point[ray]])
        image = tiling.slot_image[device, chunk, slot]
        np.testing.assert_array_equal(image, plan.order.image[structure.ray_image[ray]])
        found.append(ray)
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.arange(len(structure.ray_image)))
