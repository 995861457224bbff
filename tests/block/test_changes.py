"""Changed blocks: sigmas that are multiplied, of rays alone and beside correlated observations."""

import dataclasses

import numpy as np
import pytest
from cases.all_observations import case

from jaxbundle.block.changes import with_sigmas_multiplied
from jaxbundle.statistics.suspects import with_errors_removed


@pytest.mark.parametrize("alone", [True, False])
def test_sigmas_and_covariances_are_multiplied(alone):
    block = case("correlated")
    if alone:
        block = dataclasses.replace(block, groups=())
    factors = [np.full((len(block.structure.ray_image), 1), 2.0), *(np.full(g.sigmas.shape, 3.0) for g in block.groups)]
    found = with_sigmas_multiplied(block, factors)
    np.testing.assert_allclose(found.rays.sigmas, 2 * np.asarray(block.rays.sigmas), rtol=1e-15)
    for new, old in zip(found.groups, block.groups, strict=True):
        np.testing.assert_allclose(new.sigmas, 3 * np.asarray(old.sigmas), rtol=1e-15)
        np.testing.assert_allclose(np.asarray(old.weights), 3 * np.asarray(new.weights), rtol=1e-12, atol=1e-12)
    same = with_errors_removed(found, [])
    np.testing.assert_array_equal(same.rays.coordinates, block.rays.coordinates)


def test_rays_of_cameras_are_all_rays_and_cannot_be_changed():
    structure = case("correlated").structure
    rays = structure.rays_of_camera
    assert len(rays) == len(structure.cameras)
    np.testing.assert_array_equal(np.sort(np.concatenate(rays)), np.arange(len(structure.ray_image)))
    assert not any(own.flags.writeable for own in rays)
