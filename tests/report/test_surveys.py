"""Two surveys of the same points: what did not move is congruent, and a planted movement is found, in any datum."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from cases.free_networks import free_network, inner

import jaxbundle as jb
from jaxbundle.block.residuals import observations_of, ray_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.report.surveys import _directions, _quadratic, survey_congruency
from jaxbundle.solve.adjust import adjust

MOVED = 7


def survey(block, seed, shift=None):
    """The block observed anew: rays of its values, of which one point may be shifted, with errors of their sigmas."""
    points = block.object_points if shift is None else block.object_points.at[MOVED].add(jnp.asarray(shift))
    there = dataclasses.replace(block, object_points=points)
    v = np.array(ray_residuals(unknowns_of(there), observations_of(there))).T
    noise = np.random.default_rng(seed).normal(0, 1, v.shape) * np.asarray(block.rays.sigmas)
    rays = dataclasses.replace(block.rays, coordinates=block.rays.coordinates + v + noise)
    return adjust(dataclasses.replace(block, rays=rays))


@pytest.fixture(scope="module")
def exact():
    """A free network at the values of its adjustment."""
    return adjust(inner(free_network(2))).block


@pytest.fixture(scope="module")
def first(exact):
    return survey(inner(exact), 1)


def test_what_did_not_move_is_congruent(exact, first):
    test = survey_congruency(first, survey(inner(exact), 2))
    assert test.congruent and test.datum == "similarity" and test.full
    points = len(test.names)
    assert test.freedom == (3 * points - 7, 2 * first.redundancy) and len(test.datum_points) == points
    assert 0.001 < test.probability < 1 and 0.001 < test.variances <= 1
    t = test.difference / test.sd
    assert 0.6 < np.sqrt(np.mean(t**2)) < 1.4
    assert f"The {points} common points are congruent: F " in test.summary()
    assert "correlations between points regarded" in test.summary() and "at a level of 0.05" in test.summary()


def test_a_movement_is_found_in_any_datum(exact, first):
    """Twelve standard deviations; and the same where the second survey is in another system, of another scale."""
    sd = np.asarray(first.standard_deviations.object_points)[MOVED]
    second = survey(inner(exact), 3, 12 * sd)
    test = survey_congruency(first, second)
    name = exact.structure.point_names[MOVED]
    assert not test.congruent and [n for n, m in zip(test.names, test.moved, strict=True) if m] == [name]
    assert name not in test.datum_points and f"Moved points: 1 ({name})" in test.summary()
    row = test.names.index(name)
    assert (np.abs(test.difference[row] - 12 * sd) < 5 * test.sd[row]).all()
    elsewhere = dataclasses.replace(second, block=second.block.moved(jnp.array([100.0, -50.0, 20.0])))
    again = survey_congruency(first, elsewhere)
    assert again.statistic == pytest.approx(test.statistic, rel=1e-6)
    np.testing.assert_allclose(again.difference, test.difference, atol=1e-6)


def test_the_statistic_does_not_depend_on_the_datum(first):
    """Cofactors in another datum, S Q S^T of other points, give the same F of the shapes."""
    q = jb.covariance_of(first, lambda block: block.object_points[:9]).covariance.reshape(27, 27)
    g, d = _directions(np.asarray(first.block.object_points)[:9]), np.random.default_rng(0).normal(0, 1, 27)

    def transformed(rows):
        weights = np.repeat(np.isin(np.arange(9), rows).astype(float), 3)[:, None] * g
        return np.eye(27) - g @ np.linalg.solve(weights.T @ g, weights.T)

    everything = transformed(np.arange(9))
    values = []
    for rows in ([0, 4, 8], [1, 2, 6, 7]):
        other = transformed(rows)
        again = everything @ other
        values.append(_quadratic(again @ d, again @ q @ again.T))
    assert values[0][1] == values[1][1] == 20
    assert values[0][0] == pytest.approx(values[1][0], rel=1e-6)


def test_in_the_system_of_control_differences_are_taken_as_they_are(first):
    test = survey_congruency(first, first, datum="common")
    assert test.statistic == 0 and test.congruent and test.datum == "common"
    np.testing.assert_array_equal(test.difference, 0)


def test_what_cannot_be_tested(first):
    with pytest.raises(ValueError, match="the level 2 is not between 0 and 1"):
        survey_congruency(first, first, level=2)
    with pytest.raises(ValueError, match="no standard deviations: adjust both with precision=True"):
        survey_congruency(first, dataclasses.replace(first, cofactors=None))
    names = tuple(f"other {k}" for k in range(len(first.block.structure.point_names)))
    structure = dataclasses.replace(first.block.structure, point_names=names)
    other = dataclasses.replace(first, block=dataclasses.replace(first.block, structure=structure))
    with pytest.raises(ValueError, match="no unknown point of the same name"):
        survey_congruency(first, other)
