import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.small_folder import make_small_folder, object_points
from jaxtyping import Array

from jaxbundle.block.block import Block
from jaxbundle.block.residuals import observations_of, ray_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.forward import BAL
from jaxbundle.camera.model import CameraModel
from jaxbundle.io import read_block_folder
from jaxbundle.orientation.intersection import intersect

INTERIORS = {
    DISTORTION_FREE: (50.0, 0.2, -0.1, 0.01, 1.0),
    BROWN: (50.0, 30.0, -10.0, -1e-4, 2e-8, 1e-11, 1e-5, -2e-5, 1e-3, 2e-3, 0.01, 1.0),
    BAL: (5000.0, -0.6, 0.3),  # a third of the image height at the edge
}


@pytest.fixture
def small(tmp_path: Path) -> Block:
    return read_block_folder(make_small_folder(tmp_path))


def with_rays(block: Block, coordinates: object) -> Block:
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(coordinates))


def without_points(block: Block) -> Block:
    return eqx.tree_at(lambda b: b.object_points, block, jnp.full_like(block.object_points, jnp.nan))


def ray_residuals_of(block: Block) -> np.ndarray:
    return np.asarray(ray_residuals(unknowns_of(block), observations_of(block)))


def seen_through(block: Block, models: list[CameraModel]) -> Block:
    """The block with one camera an image and error-free rays."""
    camera = block.structure.cameras[0]
    structure = dataclasses.replace(
        block.structure,
        cameras=tuple(dataclasses.replace(camera, name=str(k), model=model) for k, model in enumerate(models)),
        image_camera=np.arange(len(models), dtype=np.int32),
        interior_free=np.zeros((len(models), max(len(INTERIORS[model]) for model in models)), bool),
    )
    interior = np.ones(structure.interior_free.shape)
    for row, model in zip(interior, models, strict=True):
        row[: len(INTERIORS[model])] = INTERIORS[model]
    block = dataclasses.replace(block, structure=structure)
    block = eqx.tree_at(
        lambda b: (b.interior.elements, b.object_points), block, (jnp.asarray(interior), jnp.asarray(object_points()))
    )
    for _ in range(30):  # v = computed - observed: adding it leads to the image of the point
        block = with_rays(block, block.rays.coordinates + ray_residuals_of(block).T)
    assert np.abs(ray_residuals_of(block)).max() < 1e-9
    return block


@pytest.mark.parametrize(
    "models",
    [[DISTORTION_FREE] * 4, [BROWN] * 4, [BAL] * 4, [BAL, BROWN, DISTORTION_FREE, BROWN]],
    ids=["none", "brown", "bal", "mixed"],
)
def test_error_free_rays_give_the_points(small: Block, models: list[CameraModel]) -> None:
    block = seen_through(small, models)
    points = np.asarray(intersect(without_points(block)).object_points)
    np.testing.assert_allclose(points, object_points(), atol=1e-9)


def test_large_coordinates(small: Block) -> None:
    shift = np.array([400_000.0, 5_600_000.0, 300.0])
    block = intersect(without_points(small.moved(jnp.asarray(shift))))
    np.testing.assert_allclose(np.asarray(block.object_points) - shift, object_points(), atol=1e-7)


def test_skew_rays_meet_in_the_middle_of_their_common_perpendicular(small: Block) -> None:
    rays = (small.structure.ray_image < 2) & (small.structure.ray_point == 8)
    structure = dataclasses.replace(
        small.structure, ray_image=small.structure.ray_image[rays], ray_point=small.structure.ray_point[rays]
    )
    offset = np.array([[0.0, 12.0], [0.0, -9.0]])
    block = dataclasses.replace(small, structure=structure)
    block = with_rays(block, small.rays.coordinates[np.flatnonzero(rays)] + offset)
    point = np.asarray(intersect(without_points(block)).object_points)[8]
    centres = np.asarray(block.exterior.projection_centre)[:2]
    feet = []
    for image, (u, v) in enumerate(np.asarray(block.rays.coordinates)):
        matrix = np.array(block.structure.rotation_system.rotation_from_angles(*block.exterior.angles[image]))
        direction = matrix.reshape(3, 3) @ [(u - 3010.0) * 0.01, -(v - 2490.0) * 0.01, -50.0]
        feet.append((centres[image], direction / np.linalg.norm(direction)))
    (a, d), (b, e) = feet
    s, t = np.linalg.lstsq(np.stack([d, -e], 1), b - a, rcond=None)[0]
    np.testing.assert_allclose(point, (a + s * d + b + t * e) / 2, atol=1e-9)


def test_rays_that_do_not_intersect_stay_open(small: Block) -> None:
    """One ray, or two rays of images at the same place; the other points are found."""
    first, second = (small.structure.ray_point == 8), (small.structure.ray_point == 9)
    keep = ~(first & (small.structure.ray_image > 0)) & ~(second & (small.structure.ray_image > 1))
    structure = dataclasses.replace(
        small.structure, ray_image=small.structure.ray_image[keep], ray_point=small.structure.ray_point[keep]
    )
    block = with_rays(dataclasses.replace(small, structure=structure), small.rays.coordinates[np.flatnonzero(keep)])
    centre, angles = block.exterior.projection_centre, block.exterior.angles
    block = eqx.tree_at(
        lambda b: (b.exterior.projection_centre, b.exterior.angles),
        block,
        (centre.at[1].set(centre[0]), angles.at[1].set(angles[0])),
    )
    ray = np.flatnonzero((structure.ray_point == 9) & (structure.ray_image == 0))[0]
    same = np.flatnonzero((structure.ray_point == 9) & (structure.ray_image == 1))[0]
    block = with_rays(block, block.rays.coordinates.at[same].set(block.rays.coordinates[ray]))
    points = np.asarray(intersect(without_points(block)).object_points)
    np.testing.assert_array_equal(np.isnan(points).any(1), np.isin(np.arange(12), [8, 9]))


def test_given_coordinates_are_kept(small: Block) -> None:
    assert intersect(small) is small
    given = small.object_points.at[8, 2].set(7.0).at[8, 0].set(jnp.nan)
    points = intersect(eqx.tree_at(lambda b: b.object_points, small, given)).object_points
    np.testing.assert_array_equal(points[8, 1:], given[8, 1:])
    np.testing.assert_allclose(points[8, 0], object_points()[8, 0], atol=1e-9)
    np.testing.assert_array_equal(points[:8], small.object_points[:8])


def test_goes_through_vmap(small: Block) -> None:
    """Points of images whose orientations and observations vary; two images are enough."""
    keep = np.flatnonzero(small.structure.ray_image < 2)
    structure = dataclasses.replace(
        small.structure, ray_image=small.structure.ray_image[keep], ray_point=small.structure.ray_point[keep]
    )
    pair = without_points(with_rays(dataclasses.replace(small, structure=structure), small.rays.coordinates[keep]))

    def points(shift: Array, noise: Array) -> Array:
        centres = pair.exterior.projection_centre.at[1].add(shift)
        block = eqx.tree_at(lambda b: b.exterior.projection_centre, pair, centres)
        return intersect(with_rays(block, block.rays.coordinates + noise)).object_points

    shifts = jnp.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.3], [1.0, 0.0, 0.0]])
    noise = jnp.asarray(np.random.default_rng(0).normal(0, 0.5, (3, len(keep), 2)))
    together = jax.jit(jax.vmap(points))(shifts, noise)
    for k in range(3):
        np.testing.assert_allclose(together[k], points(shifts[k], noise[k]), rtol=1e-9, atol=1e-9)


def test_start_of_roma(shared_data: Path) -> None:
    """sqrt(vtPv) at the start as published with the data, all points intersected."""
    block = read_block_folder(shared_data / "roma")
    assert np.sqrt((ray_residuals_of(block) ** 2).sum()) == pytest.approx(8641.3897, abs=5e-5)
