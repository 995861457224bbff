"""Rays of another program measured again, and what that does to their adjustment."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.images_in_memory import in_memory
from cases.sceaux import sceaux_block, sceaux_rays
from cases.simulated_blocks import small_block
from cases.textures import Waves, box, grey_image, interest_points, pixel_centres

import jaxbundle as jb
from jaxbundle.imagery.match_types import MatchOptions
from jaxbundle.imagery.matching import match
from jaxbundle.imagery.ray_sigmas import MIN_SIGMA
from jaxbundle.imagery.refinement import TEMPLATE, refine
from jaxbundle.imagery.window_pairs import MAX_SHIFT, PairTable, match_pairs
from jaxbundle.imagery.windows import GreyImages
from jaxbundle.measuring.measured_rays import COARSE, FINE


def every(rays, step):
    """The rays of each step-th point."""
    points = set(sorted(set(rays["point"]), key=int)[::step])
    rows = [k for k, point in enumerate(rays["point"]) if point in points]
    return {name: [column[k] for k in rows] for name, column in rays.items()}


def with_coordinates(rays, xy, rows):
    return {
        "image": [rays["image"][k] for k in rows],
        "point": [rays["point"][k] for k in rows],
        "x": xy[rows, 0].tolist(),
        "y": xy[rows, 1].tolist(),
    }


@pytest.fixture(scope="module")
def block(shared_data):
    """The rays of every fortieth point."""
    return sceaux_block(shared_data / "colmap", every(sceaux_rays(shared_data / "colmap"), 40))


def test_some_rays_of_three_images(block, shared_data):
    names = block.structure.image_names[4:7]
    images = {name: in_memory(grey_image(shared_data / "images" / "sceaux" / name)) for name in names}
    found = refine(block, images, options=MatchOptions(max_shift=MAX_SHIFT))
    assert found.matches.matched.mean() > 0.75
    assert sum(found.counts.values()) == len(found.rays)
    change = np.asarray(found.block.rays.coordinates - block.rays.coordinates)
    measured = found.measured & (found.status != TEMPLATE)
    assert measured.sum() == found.matches.matched.sum()
    assert (change[~measured] == 0).all()
    assert 0.05 < np.median(np.abs(change[measured])) < 0.5
    sigmas = np.asarray(found.block.rays.sigmas)[found.measured]
    assert sigmas.min() >= MIN_SIGMA and np.median(sigmas) < 0.4
    others = ~np.isin(np.array(block.structure.image_names)[block.structure.ray_image], names)
    assert not found.measured[others].any()


def test_images_of_another_size_are_refused(block):
    name = block.structure.image_names[0]
    with pytest.raises(jb.BlockError, match=f"image {name} has 20 x 10 px, camera c 2832 x 2128"):
        refine(block, {name: in_memory(np.zeros((10, 20)))})
    with pytest.raises(jb.BlockError, match="none of the images of the block was given"):
        refine(block, {})


@pytest.mark.thorough
def test_refined_rays_fit_better(shared_data):
    rays = every(sceaux_rays(shared_data / "colmap"), 8)
    block = sceaux_block(shared_data / "colmap", rays)
    folder = shared_data / "images" / "sceaux"
    found = refine(block, {name: in_memory(grey_image(folder / name)) for name in block.structure.image_names})
    assert found.matches.matched.mean() > 0.75
    rows = np.flatnonzero(found.measured)
    sigma0, robust = [], []
    for coordinates in (block.rays.coordinates, found.block.rays.coordinates):
        own = with_coordinates(rays, np.asarray(coordinates), rows)
        result = jb.adjust(sceaux_block(shared_data / "colmap", own), precision=False)
        sigma0.append(float(result.sigma0))
        robust.append(np.median(np.abs(np.asarray(result.residuals[0]))))
    assert sigma0[1] / sigma0[0] <= 0.85
    assert robust[1] / robust[0] <= 0.70


@pytest.mark.thorough
def test_four_levels_pull_in_four_pixels(shared_data):
    sand = grey_image(shared_data / "images" / "copr" / "IMG_0052.jpg")
    first, second = box(sand, 8, 0), box(sand, 8, 4)
    rows, columns = interest_points(first, 10, 60, 60)
    xy, count = np.stack([columns, rows], 1) + 0.5, len(rows)
    images = GreyImages({0: in_memory(first, 4), 1: in_memory(second, 4)})

    def share(levels):
        found = []
        for angle in (0.0, 2.1, 4.2):
            off = xy + 4 * np.array([np.cos(angle), np.sin(angle)])
            table = PairTable(np.zeros(count, int), np.ones(count, int), xy, off, np.tile(np.eye(2), (count, 1, 1)))
            for level in levels:
                matches = match_pairs(images, table, level, COARSE if level else FINE)
                table = table._replace(predicted=matches.position)
            found.append(np.abs(table.predicted - (xy - [0.5, 0])).max(1) < 0.2)
        return np.mean(found)

    assert share((3, 2, 1, 0)) > 0.85
    assert share((0,)) < 0.5


@pytest.mark.thorough
def test_derivative_through_matching_and_adjustment():
    """How grey values of both windows move an adjusted point: derivative of the minima = central differences."""
    block, waves, rng = jb.blocks.with_datum(small_block().block), Waves(2), np.random.default_rng(3)
    size, middle = 35, 17.5
    template = waves(*pixel_centres(11))
    searched = waves(*pixel_centres(size, (0.3, -0.2))) + 0.5 * rng.standard_normal((size, size))
    nothing, one, other = np.zeros((11, 11)), np.zeros((size, size)), np.zeros((11, 11))
    one[16, 18] = other[4, 6] = 10.0  # a single grey value near the matched point
    at_random = rng.standard_normal((11, 11)), rng.standard_normal((size, size))
    ray = 17
    point = int(block.structure.ray_point[ray])
    start = np.array([[middle, 1.0, 0.0, middle, 0.0, 1.0]])

    def adjusted(t, along):
        own, grey = (jnp.asarray(g) + t * x for g, x in zip((template, searched), along, strict=True))
        options = MatchOptions(parameters="affine")
        shift = match(own[None], grey[None], np.full((1, 2), 5.5), start, options).position[0] - middle
        moved = eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates.at[ray].add(shift))
        result = jb.adjust(moved, precision=False, stop=jb.stopping.AngleRule(1e-13))
        return result.block.object_points[point]

    with_slope = jax.jit(lambda t, along: jax.jvp(lambda t: adjusted(t, along), (t,), (1.0,)))
    for along in ((nothing, one), (other, np.zeros((size, size))), at_random):
        slope = with_slope(0.0, along)[1]
        differences = (with_slope(0.005, along)[0] - with_slope(-0.005, along)[0]) / 0.01
        assert np.abs(slope).max() > 1e-7  # m
        np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-5 * np.abs(slope).max())
