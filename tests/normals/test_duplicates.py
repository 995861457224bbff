"""A point measured twice on one image: both rays are observations of one point, nothing else changes."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.block_variants import changed, with_distances
from cases.dense_adjustment import centred, dense_cofactors, dense_system, free_values
from cases.dense_steps import assert_dense_steps
from cases.long_tracks import block_of
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block, Rays
from jaxbundle.block.validate import validate
from jaxbundle.io.bal import read_bal
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.plan.incidence import border_points
from jaxbundle.normals.plan.tiling import SLOTS
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.stopping_rules import parallax_rule


def measured_again(block: Block, rays: np.ndarray, off: float = 0.7, seed: int = 0) -> Block:
    """The block with some rays measured again: other coordinates, other sigmas, anywhere between the other rays."""
    s, rng = block.structure, np.random.default_rng(seed)
    sigmas = np.asarray(block.rays.sigmas)
    again = np.asarray(block.rays.coordinates)[rays] + off * sigmas[rays] * rng.normal(size=(len(rays), 2))
    mixed = rng.permutation(len(sigmas) + len(rays))
    coordinates = np.concatenate([np.asarray(block.rays.coordinates), again])[mixed]
    both = np.concatenate([sigmas, 1.5 * sigmas[rays]])[mixed]
    image, point = (np.concatenate([index, index[rays]])[mixed] for index in (s.ray_image, s.ray_point))
    block = changed(block, ray_image=image, ray_point=point)
    return dataclasses.replace(block, rays=Rays(jnp.asarray(coordinates), jnp.asarray(both)))


@pytest.fixture(scope="module")
def block() -> Block:
    """Rays of eliminated points, of control points and of points between which distances are measured, some thrice."""
    block = with_distances(small_block().block)
    rays = np.arange(0, len(block.structure.ray_image), 9)
    return measured_again(block, np.concatenate([rays, rays[:4]]))


def test_repeats_are_counted(block):
    s = block.structure
    assert np.bincount(s.ray_repeat)[2] == 4
    pairs = np.stack([s.ray_image, s.ray_point, s.ray_repeat], 1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_adjustment_is_the_dense_one(block):
    """Residuals, cofactors and redundancy numbers at the minimum."""
    adjustment = adjust(block, method="gauss-newton")
    assert adjustment.status is Status.CONVERGED
    unknowns, observations = centred(adjustment.block)
    system = dense_system(unknowns, observations)
    weighted = np.concatenate([np.asarray(v).T.ravel() for v in adjustment.weighted_residuals])
    np.testing.assert_allclose(weighted, system.residuals, atol=1e-7)
    gradient = system.design.T @ system.residuals / system.lengths
    assert np.abs(gradient).max() < 1e-6
    q = dense_cofactors(unknowns, observations)
    sd = adjustment.standard_deviations
    found = free_values(
        sd.projection_centre.T, sd.angles.T, sd.interior.T, sd.parameters, sd.object_points.T, observations
    )
    np.testing.assert_allclose(found, float(adjustment.sigma0) * np.sqrt(np.diagonal(q)), rtol=1e-9)
    leverages = np.sum(np.linalg.qr(system.design / system.lengths)[0] ** 2, 1)
    assert adjustment.redundancy_numbers is not None
    numbers = np.concatenate([np.asarray(r).T.ravel() for r in adjustment.redundancy_numbers])
    observed = system.design.any(1)
    np.testing.assert_allclose(numbers[observed], 1 - leverages[observed], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize(("method", "devices"), [("auto", 1), ("panels", 2), ("pcg", 1)])
def test_steps_are_the_dense_ones(block, method, devices):
    assert_dense_steps(block, method, devices)


@pytest.mark.thorough
def test_the_same_ray_twice_is_one_of_twice_the_weight():
    block = small_block().block
    rays = np.arange(5, 60, 7)
    twice = adjust(measured_again(block, rays, off=0.0))
    factor = np.ones(len(block.structure.ray_image))
    factor[rays] = np.sqrt(1 + 1 / 1.5**2)
    heavy = adjust(eqx.tree_at(lambda b: b.rays.sigmas, block, block.rays.sigmas / factor[:, None]))
    assert twice.cofactors is not None and heavy.cofactors is not None
    np.testing.assert_allclose(twice.block.object_points, heavy.block.object_points, atol=1e-6)
    np.testing.assert_allclose(twice.cofactors.object_points, heavy.cofactors.object_points, rtol=1e-7, atol=1e-12)
    assert twice.redundancy == heavy.redundancy + 2 * len(rays)


@pytest.mark.parametrize("devices", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.1], ids=["eliminated", "kept"])
def test_every_ray_has_a_cell_of_its_own(devices, share, monkeypatch):
    """Also of points with long tracks, which are kept where one is measured twice."""
    monkeypatch.setattr("jaxbundle.normals.plan.incidence.BORDER_SHARE", share)
    tracks = [np.arange(70), np.arange(10, 90), np.arange(SLOTS), np.arange(3), np.arange(5, 9)]
    block = block_of(tracks, 100, ())
    block = measured_again(block, np.flatnonzero(np.isin(block.structure.ray_point, [0, 2, 3])))
    s = block.structure
    kept = border_points(s, block.groups)
    assert kept[0] and kept[2] and not kept[3]
    plan = plan_elimination(s, block.groups, np.asarray(block.exterior.projection_centre), devices)
    found = [plan.border_rays]
    for part in plan.parts:
        device, chunk, slot, column = np.nonzero(part.tiling.ray >= 0)
        ray = part.rays[part.tiling.ray[device, chunk, slot, column]]
        image = part.tiling.slot_image[device, chunk, slot]
        np.testing.assert_array_equal(image, plan.order.image[s.ray_image[ray]])
        found.append(ray)
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.arange(len(s.ray_image)))


def test_two_rays_on_one_image_are_one_image(block):
    """They determine no point, and no y-parallax."""
    s = block.structure
    tie = np.flatnonzero(s.point_free.all(1) & (np.bincount(s.ray_point[s.ray_repeat == 0]) == 2))[0]
    keep = s.ray_point != tie
    keep[np.flatnonzero(~keep)[0]] = True
    alone = changed(block, ray_image=s.ray_image[keep], ray_point=s.ray_point[keep])
    alone = dataclasses.replace(alone, rays=Rays(block.rays.coordinates[keep], block.rays.sigmas[keep]))
    alone = measured_again(alone, np.flatnonzero(alone.structure.ray_point == tie))
    assert [p.what for p in validate(alone)] == [f"point {s.point_names[tie]} is seen on one image only"]
    parallax = parallax_rule(block, 1e-6).of(block).parallax(centred(block)[0])
    assert np.isfinite(parallax).all()


@pytest.mark.thorough
def test_bal_file_with_repeated_rays(shared_data):
    block = read_bal(shared_data / "cases" / "fuzz" / "bal-duplicate" / "ladybug-dup.txt")
    assert (block.structure.ray_repeat > 0).any()
    adjustment = adjust(block, max_iterations=2, precision=False)
    assert np.isfinite(adjustment.residuals[0]).all() and float(adjustment.vtpv) > 0
