"""The scatter of many adjustments of the same block agrees with the covariance that each of them reports.

With normal errors of the sigmas given, the sums over the draws

    e^T Q^-1 e / sigma^2        e: estimate less truth of an image, a camera, a point, or of all unknowns together
    v^T P v / sigma^2

follow chi-square distributions with as many degrees of freedom as there are elements of e, or as is the redundancy.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense import centred, dense_cofactors, free_values
from jaxtyping import Array, Float
from scipy.stats import chi2

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulate import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Status

DRAWS = 200
ONE_IN_A_MILLION = 1e-6  # two-sided level of a single test; there are some fifty, and the seed is fixed


class Sample(NamedTuple):
    """Errors of the estimates, each with a leading axis of draws."""

    exterior: Float[Array, "draw image 6"]
    interior: Float[Array, "draw camera element"]
    points: Float[Array, "draw point 3"]
    vtpv: Float[Array, " draw"]
    status: Float[Array, " draw"]


def truth() -> Block:
    """A self-calibrated strip with weighted control, distance to its truth 0."""
    camera = AerialCamera(estimate=("principal_distance",))
    simulation = simulate(1, 3, camera=camera, points_per_image=14, control_sigma=0.05, check_points=0, seed=3)
    return with_datum(simulation.truth)


def drawn(block: Block, key: Array) -> Block:
    """The block with new errors in everything observed."""
    keys = jax.random.split(key, 1 + len(block.groups))
    rays = block.rays.coordinates + block.rays.sigmas * jax.random.normal(keys[0], block.rays.sigmas.shape)
    groups = tuple(
        eqx.tree_at(lambda g: g.values, g, g.values + g.sigmas * jax.random.normal(k, g.sigmas.shape))
        for g, k in zip(block.groups, keys[1:], strict=True)
    )
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), block, (rays, groups))


@pytest.fixture(scope="module")
def block() -> Block:
    return truth()


@pytest.fixture(scope="module")
def reported(block) -> Adjustment:
    """One adjustment, without errors: its cofactors are those at the truth."""
    adjustment = adjust(block)
    assert adjustment.trustworthy
    return adjustment


@pytest.fixture(scope="module")
def sample(block) -> Sample:
    """All adjustments in one program, from the truth."""

    def errors(key: Array) -> Sample:
        found = adjust(drawn(block, key), precision=False, max_iterations=20)
        exterior = [jnp.concatenate([b.exterior.projection_centre, b.exterior.angles], 1) for b in (found.block, block)]
        return Sample(
            exterior[0] - exterior[1],
            found.block.interior.elements - block.interior.elements,
            found.block.object_points - block.object_points,
            found.vtpv,
            found.iterations.status,
        )

    return jax.jit(jax.vmap(errors))(jax.random.split(jax.random.key(8), DRAWS))


def assert_chi_square(total: float, degrees: int) -> None:
    lower, upper = chi2.ppf([ONE_IN_A_MILLION / 2, 1 - ONE_IN_A_MILLION / 2], degrees)
    assert lower < total < upper, (total / degrees, lower / degrees, upper / degrees)


def assert_scatter(
    errors: Float[np.ndarray, "draw element"], cofactors: Float[Array | np.ndarray, "element element"]
) -> None:
    """Normed errors of one vector over all draws."""
    normed = np.linalg.solve(np.linalg.cholesky(np.asarray(cofactors)), np.asarray(errors).T)
    assert_chi_square(float((normed**2).sum()), normed.size)


def test_every_draw_converges(sample):
    assert (np.asarray(sample.status) == Status.CONVERGED).all()


def test_images_cameras_and_points(sample, block, reported):
    cofactors = reported.cofactors
    assert isinstance(cofactors, BlockCofactors)
    for i in range(len(block.structure.image_names)):
        assert_scatter(sample.exterior[:, i], cofactors.exterior[i])
    for p, free in enumerate(block.structure.point_free):
        assert_scatter(sample.points[:, p, free], cofactors.object_points[p][np.ix_(free, free)])
    columns = np.array(block.structure.interior_columns)
    assert_scatter(sample.interior[:, 0, columns], cofactors.interior[0][np.ix_(columns, columns)])


def test_all_unknowns_together(sample, block):
    """With the covariances between images and points, which the report does not print."""
    unknowns, observations = centred(block)
    interior = jnp.swapaxes(sample.interior, 1, 2)
    none = jnp.zeros(0)
    draws = [
        free_values(exterior[:, :3].T, exterior[:, 3:].T, by_camera, none, points.T, observations)
        for exterior, by_camera, points in zip(sample.exterior, interior, sample.points, strict=True)
    ]
    assert_scatter(np.array(draws), dense_cofactors(unknowns, observations))


def test_sigma0(sample, block):
    """v^T P v of all draws; the mean of sigma0^2 is 1."""
    assert_chi_square(float(sample.vtpv.sum()), DRAWS * block.redundancy)
    assert float(sample.vtpv.mean()) / block.redundancy == pytest.approx(
        1, abs=4 * np.sqrt(2 / DRAWS / block.redundancy)
    )
    quantiles = chi2.cdf(np.asarray(sample.vtpv), block.redundancy)
    np.testing.assert_allclose(np.quantile(quantiles, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.1)
