"""Absolute orientation: published figures, every mixture of control, all solutions, and standard deviations."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.geometry.rotation import from_omega_phi_kappa, to_omega_phi_kappa
from jaxbundle.orientation.absolute_orientations import absolute_orientation

TERRAIN = np.random.default_rng(0).uniform(-1, 1, (8, 3)) * [1.0, 1.0, 0.3]
SCALE, TRANSLATION = 850.0, np.array([400_000.0, 5_600_000.0, 250.0])
CENTRES = np.array([[-0.5, 0.0, 2.0], [0.5, 0.0, 2.0]])


def example(shared_data, name: str) -> dict:
    return json.loads((shared_data / "approximate" / f"{name}.json").read_text())


def turned(*angles: float) -> np.ndarray:
    return np.stack(from_omega_phi_kappa(*angles)).reshape(3, 3)


def given(points: np.ndarray, r: np.ndarray, plan: list[int], heights: list[int]) -> np.ndarray:
    x = SCALE * points @ r.T + TRANSLATION
    missing = np.full_like(x, np.nan)
    missing[plan, :2], missing[heights, 2] = x[plan, :2], x[heights, 2]
    return missing


def test_course_example(shared_data):
    """Equal weights: all digits of the independent computation."""
    data = example(shared_data, "absolute_orientation_engo531")
    expected = data["computed_here_not_published"]
    found = absolute_orientation(data["model"], data["object"])
    assert float(found.similarity.scale) == pytest.approx(expected["lam"], abs=5e-9)
    np.testing.assert_allclose(found.similarity.translation, expected["T"], atol=1e-6)
    transposed = to_omega_phi_kappa(tuple(np.asarray(found.similarity.rotation).T.ravel()))  # the course's convention
    np.testing.assert_allclose(np.degrees(np.stack(transposed)), expected["opk_deg_of_R"], atol=1e-6)
    np.testing.assert_allclose(found.residuals, expected["residuals"], atol=1e-6)
    assert float(found.sigma0) == pytest.approx(expected["s0"], abs=5e-6)
    assert found.redundancy == 11 and found.words == ""


@pytest.mark.parametrize("weights", ["both", "control_only", "equal"])
def test_weights_on_both_sides(shared_data, weights):
    """Wolf and Ghilani's example; the scale with weights on both sides is published.

    The published 0.9499549354 leaves the change of the weights out of the normal equations, which ends 7e-11 beside the
    minimum of v^T Q^-1 v, 0.94995493547.
    """
    data = example(shared_data, "conformal_ghilani")
    expected = data["computed_here"][weights]
    options = {"both": {"model_sigmas": data["s_xyz"]}}.get(weights, {})
    sigmas = 1.0 if weights == "equal" else data["s_XYZ"]
    found = absolute_orientation(data["xyz"], data["XYZ"], sigmas, **options)
    assert float(found.similarity.scale) == pytest.approx(expected["lam"], abs=1e-10)
    if weights == "both":
        published = data["published"]["scale_both_sides_weighted"]
        assert float(found.similarity.scale) == pytest.approx(published, abs=1e-10)
        assert float(jnp.sqrt(found.cofactors[0, 0])) == pytest.approx(expected["sd_lam"], abs=5e-8)  # a priori
    assert float(found.sigma0) == pytest.approx(expected["s0"], abs=1e-6)
    np.testing.assert_allclose(found.similarity.translation, expected["T"], atol=1e-5 if weights == "both" else 2e-6)


MIXTURES = {
    "three full": ([0, 1, 2], [0, 1, 2]),
    "four plan, four heights": ([0, 1, 2, 3], [4, 5, 6, 7]),
    "all": (list(range(8)), list(range(8))),
    "two full, five heights": ([0, 1], [0, 1, 2, 3, 4, 5, 6]),
}


@pytest.mark.parametrize("mixture", MIXTURES)
@pytest.mark.parametrize("angles", [(0.02, -0.01, 2.5), (1.4, 0.3, -2.0)], ids=["level", "tilted"])
def test_truth_from_nothing(mixture, angles):
    r = turned(*angles)
    found = absolute_orientation(TERRAIN, given(TERRAIN, r, *MIXTURES[mixture]), 0.1)
    k = int(np.nanargmin(np.linalg.norm(np.asarray(found.solutions.rotation) - r, axis=(1, 2))))
    assert found.possible[k]
    np.testing.assert_allclose(found.solutions.rotation[k], r, atol=1e-8)
    np.testing.assert_allclose(found.solutions.scale[k], SCALE, rtol=1e-8)
    np.testing.assert_allclose(found.solutions.translation[k], TRANSLATION, atol=1e-5)
    if mixture in ("three full", "all"):
        assert found.possible.sum() == 1 and found.words == ""


def test_two_full_points_and_a_height_have_two_orientations():
    for seed in range(5):
        angles = np.random.default_rng(seed).uniform(-0.15, 0.15, 3) + [0, 0, seed]
        r = turned(*angles)
        control = given(TERRAIN, r, [0, 1], [0, 1, 2])
        found = absolute_orientation(TERRAIN, control, 0.1, projection_centres=CENTRES)
        assert found.possible.sum() == 2 and "2 orientations fit the control" in found.words
        np.testing.assert_allclose(found.similarity.rotation, r, atol=1e-7)
        assert np.isnan(found.sigma0) and np.isfinite(found.cofactors).all()


def test_control_on_a_line_leaves_a_rotation():
    line = np.linspace([-1, -0.5, 0], [1, 0.5, 0.2], 5)
    found = absolute_orientation(line, SCALE * line + TRANSLATION)
    assert found.on_a_line and np.isnan(found.cofactors).all() and "lies on a line" in found.words


def test_is_never_a_reflection():
    mirrored = SCALE * TERRAIN[:, [1, 0, 2]] + TRANSLATION
    found = absolute_orientation(TERRAIN, mirrored)
    assert np.linalg.det(np.asarray(found.similarity.rotation)) == pytest.approx(1.0)
    assert found.mirrored and "mirror image" in found.words
    assert not absolute_orientation(TERRAIN * [1, 1, 0], mirrored * [1, 1, 0]).mirrored


def test_scatter_is_the_covariance():
    """300 draws at once, errors in both systems, one point of plan and one of height only."""
    r, rng, draws = turned(0.1, -0.2, 1.0), np.random.default_rng(6), 300
    control = given(TERRAIN, r, [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3, 4, 5, 7])
    model_sigmas, sigmas = np.full((8, 3), 2e-4) * [1, 1, 2], np.full((8, 3), 0.2)
    x = TERRAIN + model_sigmas * rng.standard_normal((draws, 8, 3))
    o = control + sigmas * rng.standard_normal((draws, 8, 3))

    @jax.jit
    @jax.vmap
    def elements(x, o):
        found = absolute_orientation(x, o, sigmas, model_sigmas=model_sigmas)
        at = jnp.concatenate([found.similarity.scale[None], found.angles, found.similarity.translation])
        return at, found.cofactors, found.sigma0

    at, cofactors, sigma0 = elements(x, o)
    d = np.asarray(at) - np.r_[SCALE, 0.1, -0.2, 1.0, TRANSLATION]
    squares = np.einsum("ki,kij,kj->k", d, np.linalg.inv(np.asarray(cofactors)), d)
    assert squares.mean() == pytest.approx(7.0, abs=4 * np.sqrt(14 / draws))
    assert (np.asarray(sigma0) ** 2).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 13 / draws))


@pytest.mark.usefixtures("unchecked_types")  # shapes that do not fit
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_points": TERRAIN[:4]}, r"shape \(8, 3\) and object points of shape \(4, 3\)"),
        ({"object_points": given(TERRAIN, np.eye(3), [0], [1, 2, 3])}, "1 plan positions and 3 heights do not"),
        ({"model_points": TERRAIN * np.nan}, "a model coordinate is not a finite number"),
        ({"sigmas": 0.0}, "a standard deviation is not positive"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(ValueError, match=message):
        absolute_orientation(**{"model_points": TERRAIN, "object_points": TERRAIN, **change})
