"""Simulated blocks: their truth fulfils the image equation, and the adjustment finds it again."""

import numpy as np
import pytest
from cases.simulated_blocks import CAMERA, small_block

from jaxbundle.block.observation_kinds import CONTROL, STATIONS
from jaxbundle.block.residuals import group_residuals, observations_of, ray_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.block.validate import validate
from jaxbundle.diagnosis.sigmas import global_test
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import exact_coordinates, simulate
from jaxbundle.solve.adjust import adjust


def test_truth_leaves_no_residual():
    truth = small_block().truth
    unknowns, observations = unknowns_of(truth), observations_of(truth)
    assert np.abs(ray_residuals(unknowns, observations)).max() < 1e-8  # px
    for group in observations.groups:
        assert np.abs(np.where(group.weights > 0, group_residuals(unknowns, group), 0.0)).max() == 0


@pytest.mark.parametrize("camera", [AerialCamera(), AerialCamera(coefficients={"K1": 2e-6, "P2": 1e-5}), CAMERA])
def test_images_show_what_they_see(camera):
    block, truth = simulate(2, 3, camera=camera, points_per_image=30)
    structure = block.structure
    inside = np.abs(np.asarray(truth.rays.coordinates) - camera.centre)
    assert (inside <= np.array([camera.width, camera.height]) / 2 / (camera.pixel_size or 1)).all()
    assert structure.cameras[0].image_unit == ("px" if camera.pixel_size else "mm")
    assert structure.cameras[0].model.name == ("brown" if camera.coefficients else "none")
    assert len(set(zip(structure.ray_image, structure.ray_point, strict=True))) == len(structure.ray_image)
    assert not validate(block)


def test_every_image_has_points_and_every_tie_point_two_images():
    structure = simulate(3, 5).block.structure
    assert np.bincount(structure.ray_image, minlength=15).min() >= 20
    rays = np.bincount(structure.ray_point)
    assert rays[structure.point_free.all(1)].min() >= 2 and rays.min() >= 1
    assert structure.image_names[:6] == ("1_01", "1_02", "1_03", "1_04", "1_05", "2_01")
    assert structure.point_names[:3] == ("1", "2", "3")
    assert (~structure.point_free.all(1)).sum() == 8  # two rows of four


def test_second_strip_is_flown_back():
    truth = simulate(2, 4).truth
    x = np.asarray(truth.exterior.projection_centre)[:, 0]
    assert (np.diff(x[:4]) > 0).all() and (np.diff(x[4:]) < 0).all()
    assert np.allclose(np.asarray(truth.exterior.angles)[4:, 2], np.pi, atol=0.2)


def test_errors_are_as_large_as_their_sigmas():
    block, truth = small_block()
    size = np.asarray((block.rays.coordinates - truth.rays.coordinates) / block.rays.sigmas)
    assert np.std(size) == pytest.approx(1, abs=0.1)
    assert [group.structure.kind for group in block.groups] == [CONTROL, STATIONS]
    assert not block.groups[0].structure.observed[:, 2].any()  # their Z is fixed
    for noisy, exact in zip(block.groups, truth.groups, strict=True):
        assert (
            0 < np.abs(noisy.values - exact.values).max() < 5 * np.asarray(exact.sigmas)[exact.structure.observed].max()
        )


def test_same_seed_same_block_other_seed_other_block():
    first, again, other = (simulate(seed=seed).block for seed in (1, 1, 2))
    assert np.array_equal(first.rays.coordinates, again.rays.coordinates)
    assert first.rays.coordinates.shape != other.rays.coordinates.shape or not np.array_equal(
        first.rays.coordinates, other.rays.coordinates
    )


def test_without_control_the_datum_is_held_at_the_truth():
    block, truth = simulate(control_rows=0)
    held = ~block.structure.exterior_free
    assert held.sum() == 7 and block.structure.datum.kind == "fixed"
    given, true = (np.hstack([b.exterior.projection_centre, b.exterior.angles]) for b in (block, truth))
    assert np.array_equal(given[held], true[held])
    assert not np.isclose(given[~held], true[~held]).any()


def test_held_elements_start_at_the_truth_and_unknown_ones_do_not():
    block, truth = small_block()
    free = block.structure.interior_free
    assert np.array_equal(block.interior.elements[~free], truth.interior.elements[~free])
    assert not np.isclose(block.interior.elements[free], truth.interior.elements[free]).all()
    fixed = ~block.structure.point_free
    assert np.array_equal(np.asarray(block.object_points)[fixed], np.asarray(truth.object_points)[fixed])


def test_coordinates_of_any_block_can_be_made_exact():
    block = small_block().truth
    coordinates, left = exact_coordinates(block)
    assert np.abs(left).max() < 1e-8
    assert np.allclose(coordinates, block.rays.coordinates, atol=1e-8)


def test_exact_observations_adjust_to_the_truth():
    block, truth = small_block(noise=0.0)
    adjusted = adjust(block).block
    for found, true in (
        (adjusted.exterior.projection_centre, truth.exterior.projection_centre),
        (adjusted.exterior.angles, truth.exterior.angles),
        (adjusted.interior.elements, truth.interior.elements),
        (adjusted.object_points, truth.object_points),
    ):
        assert np.allclose(found, true, rtol=1e-9, atol=1e-7)


def test_normal_errors_give_a_sigma0_of_one():
    block, truth = small_block()
    adjustment = adjust(block)
    assert adjustment.trustworthy
    assert global_test(float(adjustment.sigma0), adjustment.redundancy).passed
    free = block.structure.point_free
    error = np.asarray(adjustment.block.object_points - truth.object_points)[free]
    deviations = np.asarray(adjustment.standard_deviations.object_points)[free]
    assert np.sqrt(np.mean((error / deviations) ** 2)) == pytest.approx(1, abs=0.25)


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"images": 1}, "1 strips of 1 images; a block needs at least 1 strip of 2 images"),
        ({"forward_overlap": 0.4}, "forward overlap is from 0.5 to below 1"),
        ({"side_overlap": 1.0}, "side overlap from 0 to below 1"),
        ({"camera": AerialCamera(coefficients={"K9": 1.0})}, "no interior element K9; there are principal_distance"),
        ({"camera": AerialCamera(estimate=("f",))}, "no interior element f"),
    ],
)
def test_impossible_flights_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(**arguments)
