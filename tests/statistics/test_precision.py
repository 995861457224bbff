"""Variances of functions of the unknowns are those of the dense covariance matrix, in every datum."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import case
from cases.dense_adjustment import centred, dense_cofactors
from cases.free_networks import free_network, inner

from jaxbundle.solve.adjust import adjust
from jaxbundle.statistics.covariance import covariance_of, error_ellipses, error_ellipsoids


@pytest.fixture(scope="module")
def reported():
    return adjust(case("all observations"))


def several(block):
    """Of every sort of unknowns: a distance, a height, an angle and a centre, the principal distance, a parameter."""
    a, b = block.object_points[2], block.object_points[9]
    return jnp.stack(
        [
            jnp.sqrt(jnp.sum((a - b) ** 2)),
            block.object_points[5, 2] * 2.0,
            block.exterior.angles[1, 0] + 1e-3 * block.exterior.projection_centre[2, 2],
            block.interior.elements[0, 0] - block.exterior.projection_centre[0, 2] / 10.0,
            block.parameters[0] * block.parameters[1],
        ]
    )


def test_covariance_is_the_dense_one(reported):
    found = covariance_of(reported, several)
    q = dense_cofactors(*centred(reported.block))
    s = reported.block.structure
    images, points = len(s.image_names), len(s.point_names)
    masks = [s.exterior_free.T, s.interior_free.T[list(s.interior_columns)], s.parameter_free, s.point_free.T]
    place = np.split(np.cumsum(np.concatenate([m.ravel() for m in masks])) - 1, np.cumsum([m.size for m in masks])[:-1])
    rows = np.zeros((5, len(q)))
    x = np.asarray(reported.block.object_points)
    unit = (x[2] - x[9]) / np.linalg.norm(x[2] - x[9])

    def add(row, part, index, value):
        if masks[part].ravel()[index]:
            rows[row, place[part][index]] += value

    for k in range(3):
        add(0, 3, k * points + 2, unit[k])
        add(0, 3, k * points + 9, -unit[k])
    add(1, 3, 2 * points + 5, 2.0)
    add(2, 0, 3 * images + 1, 1.0)
    add(2, 0, 2 * images + 2, 1e-3)
    add(3, 1, 0, 1.0)
    add(3, 0, 2 * images, -0.1)
    p = np.asarray(reported.block.parameters)
    add(4, 2, 0, p[1])
    add(4, 2, 1, p[0])
    expected = float(reported.sigma0) ** 2 * rows @ q @ rows.T
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(found.covariance / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-8)
    np.testing.assert_allclose(found.values, several(reported.block))
    np.testing.assert_allclose(found.standard_deviations, scale, rtol=1e-8)


@pytest.mark.thorough
def test_free_network_has_its_own_variances():
    """Of single coordinates they are those reported; of a ratio of distances, the same in every datum."""
    block = free_network(2)
    free, minimal = adjust(inner(block)), adjust(block)
    found = covariance_of(free, lambda b: b.object_points[7])
    np.testing.assert_allclose(found.standard_deviations, free.standard_deviations.object_points[7], rtol=1e-7)

    def ratio(b):
        x = b.object_points
        return jnp.linalg.norm(x[3] - x[8]) / jnp.linalg.norm(x[5] - x[11])

    one, other = (covariance_of(a, ratio).standard_deviations for a in (free, minimal))
    np.testing.assert_allclose(one, other, rtol=1e-6)


def test_ellipsoids(reported):
    axes, directions = error_ellipsoids(reported)
    q = float(reported.sigma0) ** 2 * np.asarray(reported.cofactors.object_points)
    np.testing.assert_allclose(np.einsum("pca,pa,pda->pcd", directions, axes**2, directions), q, atol=1e-12 * q.max())
    assert (np.diff(axes, axis=1) <= 0).all()
    plane = error_ellipses(reported)
    assert (plane.semi_axes[:, 0] <= axes[:, 0] * (1 + 1e-9)).all()
