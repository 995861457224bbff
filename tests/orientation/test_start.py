"""A start that is checked: absurd approximate values are replaced, all others stay to the last bit."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.mistaken_folders import made

import jaxbundle as jb
from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.orientation.checked_start import with_checked_start
from jaxbundle.orientation.sight import HALF, off, sight_of

DATA_SETS = (
    "strasbourg-s1-fixed",
    "strasbourg-s2-weighted",
    "strasbourg-s4-tie",
    "camcal-c1-fixed",
    "camcal-c2-weighted",
    "camcal-selfcal-3",
    "roma",
    "bal/dubrovnik-3-7-pre.txt",
    "bal/problem-49-7776-pre.txt",
    "bal/ladybug-49-shrink-1800.txt",
)


@pytest.fixture(scope="module")
def simulated() -> Block:
    return jb.simulate(2, 4, points_per_image=20, seed=1).block


def with_angles(block: Block, angles: np.ndarray) -> Block:
    return eqx.tree_at(lambda b: b.exterior.angles, block, jnp.asarray(angles))


def images_of(found: Finding) -> set[str]:
    return {subject.names[0] for subject in found.subjects}


def agreement(block: Block) -> float:
    """Largest angle in degrees by which a ray is off its point, of 95 percent."""
    sight = sight_of(block)
    return float(np.degrees(np.percentile(off(sight, sight.points), 95)))


@pytest.mark.parametrize("name", DATA_SETS)
def test_real_blocks_stay_as_they_are(shared_data, name):
    block = jb.read(shared_data / name, check_start=False)
    checked, found = with_checked_start(block)
    assert checked is block
    assert found == ()


def test_rough_values_stay_as_they_are(simulated):
    checked, found = with_checked_start(simulated)
    assert checked is simulated
    assert found == ()


def test_a_turned_image_is_resected(simulated):
    angles = np.array(simulated.exterior.angles)
    angles[2, 2] += np.pi
    checked, found = with_checked_start(with_angles(simulated, angles))
    (replaced,) = found
    assert replaced.kind is Kind.REPAIRED
    assert replaced.severity is Severity.NOTE
    assert replaced.subjects == (Subject("images", (simulated.structure.image_names[2],)),)
    assert replaced.size == pytest.approx(180, abs=5)
    assert replaced.unit == "deg"
    others = np.arange(len(angles)) != 2
    np.testing.assert_array_equal(checked.exterior.angles[others], simulated.exterior.angles[others])
    np.testing.assert_array_equal(checked.object_points, simulated.object_points)
    assert agreement(checked) < 1.5 * agreement(simulated)


def test_all_images_at_the_origin_are_resected(simulated):
    nothing = eqx.tree_at(
        lambda b: b.exterior, simulated, jb.blocks.ExteriorOrientation(*(jnp.zeros((8, 3)) for _ in range(2)))
    )
    checked, (replaced,) = with_checked_start(nothing)
    assert replaced.kind is Kind.REPAIRED
    assert images_of(replaced) == set(simulated.structure.image_names)
    assert agreement(checked) < 1.5 * agreement(simulated)


def test_images_that_are_held_are_never_changed(simulated):
    angles = np.array(simulated.exterior.angles)
    angles[2, 2] += np.pi
    free = simulated.structure.exterior_free.copy()
    free[2, 0] = False
    block = with_angles(simulated, angles)
    block = dataclasses.replace(block, structure=dataclasses.replace(block.structure, exterior_free=free))
    checked, _ = with_checked_start(block)
    np.testing.assert_array_equal(checked.exterior.angles, block.exterior.angles)


def test_an_absurd_point_is_intersected(simulated):
    free = np.flatnonzero(simulated.structure.point_free.all(1))
    points = np.array(simulated.object_points)
    points[free[3], 2] += 4000.0
    block = eqx.tree_at(lambda b: b.object_points, simulated, jnp.asarray(points))
    checked, (replaced,) = with_checked_start(block)
    assert replaced.kind is Kind.REPAIRED
    assert replaced.subjects == (Subject("points", (simulated.structure.point_names[free[3]],)),)
    assert replaced.size == pytest.approx(4000, rel=0.1)
    assert np.linalg.norm(checked.object_points[free[3]] - simulated.object_points[free[3]]) < 400
    np.testing.assert_array_equal(checked.exterior.angles, simulated.exterior.angles)


def test_points_at_the_origin_are_intersected(simulated):
    free = simulated.structure.point_free
    block = eqx.tree_at(lambda b: b.object_points, simulated, jnp.where(free, 1e6, simulated.object_points))
    checked, (replaced,) = with_checked_start(block)
    assert {subject.table for subject in replaced.subjects} == {"points"}
    np.testing.assert_array_equal(checked.object_points[~free.all(1)], simulated.object_points[~free.all(1)])
    assert agreement(checked) < 1.5 * agreement(simulated)


def test_mirrored_images_are_not_repaired(simulated):
    mirrored = eqx.tree_at(
        lambda b: b.rays.coordinates, simulated, simulated.rays.coordinates * jnp.array([[1.0, -1.0]])
    )
    checked, found = with_checked_start(mirrored)
    assert checked is mirrored
    assert found == ()


def test_a_point_whose_rays_diverge_is_named(shared_data):
    block = jb.read(shared_data / "cases" / "06-no-parallax" / "no-approx", check_start=False)
    checked, (found,) = with_checked_start(block)
    assert (found.kind, found.subjects) == (Kind.WEAK, (Subject("points", ("FAR",)),))
    sight = sight_of(checked)
    assert (off(sight, sight.points) < HALF).all()


@pytest.mark.parametrize(
    ("mistake", "images"),
    [("a29", {"8936"}), ("a30", None), ("a35", None), ("a36", None), ("a57", None), ("a58", None), ("a71", None)],
)
def test_mistakes_that_a_resection_cures(shared_data, tmp_path: Path, mistake, images):
    block = jb.read(made(shared_data, mistake, tmp_path), check_start=False)
    checked, (replaced,) = with_checked_start(block)
    assert replaced.kind is Kind.REPAIRED
    assert images_of(replaced) == (images or set(block.structure.image_names))
    assert agreement(checked) < 2


@pytest.mark.parametrize("case", ["cameras-below-ground", "looking-up", "one-point-above", "free-mirrored"])
def test_points_come_to_lie_in_front(shared_data, case):
    block = jb.read(shared_data / "cases" / "22-behind-the-camera" / case, check_start=False)
    checked, found = with_checked_start(block)
    assert {finding.kind for finding in found} == {Kind.REPAIRED}
    sight = sight_of(checked)
    assert (off(sight, sight.points) < HALF).all()


@pytest.mark.thorough
@pytest.mark.parametrize("mistake", ["a29", "a30", "a35", "a57", "a58", "a71"])
def test_the_adjustment_then_gives_the_right_result(shared_data, tmp_path: Path, mistake):
    right = jb.adjust(jb.read(shared_data / "strasbourg-s4-tie", check_start=False), precision=False)
    checked, _ = with_checked_start(jb.read(made(shared_data, mistake, tmp_path), check_start=False))
    found = jb.adjust(checked, precision=False)
    np.testing.assert_allclose(
        found.block.exterior.projection_centre, right.block.exterior.projection_centre, atol=1e-5
    )
    assert float(found.sigma0) == pytest.approx(float(right.sigma0), rel=1e-9)
