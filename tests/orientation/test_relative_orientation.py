"""Relative orientation: published figures, the truth from nothing, wrong points, and scatter = covariance."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.camera.forward import BAL
from jaxbundle.geometry.rotation import from_rotation_vector
from jaxbundle.orientation.coplanarity import Pair, Rays, parallaxes
from jaxbundle.orientation.relative_orientations import relative_orientation

INTERIOR = np.array([100.0, 0.0, 0.0, 1.0, 1.0])
BAL_INTERIOR = np.array([100.0, -0.3, 0.1])
NOISE, POINTS, SAMPLES = 0.01, 40, 128


def example(shared_data, name: str) -> dict:
    return json.loads((shared_data / "approximate" / f"{name}.json").read_text())


def image(x: np.ndarray) -> np.ndarray:
    return -100 * x[:, :2] / x[:, 2:]


def pair(seed: int, base=(1.0, 0.1, -0.05), relief=0.3, points=POINTS, kappa=True):
    """Exact image coordinates, the rotation of the second image, points; the ground 2 below the first image."""
    rng = np.random.default_rng(seed)
    vector = rng.normal(0, 0.05, 3) + [0, 0, rng.uniform(-3, 3) if kappa else 0]
    r = np.stack(from_rotation_vector(*vector)).reshape(3, 3)
    x = rng.uniform(-1, 1, (points, 3)) * [1, 1.2, relief] + [0.5, 0, -2]
    return image(x), image((x - np.array(base)) @ r), r, x


def padded(interior, first, second, sigma: float, **options):
    """One program for all numbers of points: those that are added take no part."""
    count = len(first)
    first, second = (np.concatenate([xy, np.zeros((POINTS - count, 2))]) for xy in (first, second))
    sigmas = np.where(np.arange(POINTS) < count, sigma, np.inf)[:, None]
    return relative_orientation(
        DISTORTION_FREE, np.array(interior, float), first, second, sigmas, samples=SAMPLES, **options
    )


def oriented(first, second, seed: int, noise=NOISE, **options):
    rng = np.random.default_rng(1000 + seed)
    first, second = (xy + noise * rng.standard_normal(xy.shape) for xy in (first, second))
    return padded(INTERIOR, first, second, NOISE, **options)


def test_course_example(shared_data):
    """Published by an unweighted adjustment; the right weights change the fifth digit."""
    data = example(shared_data, "relative_orientation_engo531")
    expected = data["computed_here"]["sampson_weighted_equals_bundle"]
    interior = [data["c_mm"], 0, 0, 1, 1]
    found = padded(interior, data["left_mm"], data["right_mm"], 1.0, base=92.0)
    assert found.names == ("by", "bz", "omega2", "phi2", "kappa2") and found.words == "" and found.redundancy == 1
    values = [expected[name] for name in ("by", "bz", "omega_deg", "phi_deg", "kappa_deg")]
    np.testing.assert_allclose([*found.elements[:2], *np.degrees(found.elements[2:])], values, atol=1.1e-6)
    published = list(data["published"].values())
    np.testing.assert_allclose(values, published, atol=6e-4)
    assert float(found.sigma0) == pytest.approx(expected["s0_mm_unit_weight_image_coordinate"], abs=1e-8)
    np.testing.assert_allclose(found.model_points[:6], data["published_model_mm"], atol=1e-3)
    # y-parallaxes: sqrt 2 times the residual of unit weight
    assert float(jnp.sum(found.parallaxes[:6] ** 2)) == pytest.approx(2 * float(found.sigma0) ** 2, rel=1e-9)


def test_textbook_example(shared_data):
    """Wolf and Dewitt's data, against the bundle of two photographs: elements, standard deviations, model."""
    data = example(shared_data, "relative_orientation_wolf")
    expected, xy = data["computed_here_not_published"], np.array(list(data["points"].values()))
    interior = [data["f_mm"], 0, 0, 1, 1]
    found = padded(interior, xy[:, :2], xy[:, 2:], 1.0, base=expected["XL"])
    values = [expected["YL"], expected["ZL"] - data["f_mm"]]
    angles = ("omega_deg", "phi_deg", "kappa_deg")
    np.testing.assert_allclose(found.elements[:2], values, atol=1e-6)
    np.testing.assert_allclose(np.degrees(found.elements[2:]), [expected[name] for name in angles], atol=1e-6)
    assert float(found.sigma0) == pytest.approx(expected["s0"], abs=1e-8)
    sd = [expected["sd"][name] for name in ("YL", "ZL")]
    np.testing.assert_allclose(found.standard_deviations[:2], sd, atol=1e-6)
    sd = [expected["sd"][name] for name in angles]
    np.testing.assert_allclose(np.degrees(found.standard_deviations[2:]), sd, atol=1e-6)
    model = np.array(list(expected["model"].values())) - [0, 0, data["f_mm"]]
    np.testing.assert_allclose(found.model_points[:6], model, atol=1e-6)


def test_two_wrong_points_of_twelve(shared_data):
    """COLMAP's example: the first ten fit; coordinates with y down."""
    data = example(shared_data, "five_point_colmap12")
    first, second = np.array(data["x1"]) * [1, -1], np.array(data["x2"]) * [1, -1]
    found = padded([1, 0, 0, 1, 1], first, second, data["max_error"] / 3)
    np.testing.assert_array_equal(found.used, np.arange(POINTS) < 10)


ACROSS, ALONG, FORWARD = (1, 0.1, -0.05), (0, -1, 0.1), (0.02, 0.01, -0.5)


@pytest.mark.parametrize(
    ("base", "relief"),
    [(ACROSS, 0.3), (ALONG, 0.3), (FORWARD, 0.3), (ACROSS, 0.0), (ALONG, 0.0)],
    ids=["x", "y", "forward", "x, plane", "y, plane"],
)
def test_exact_coordinates_give_the_truth(base, relief):
    first, second, r, x = pair(3, base, relief)
    found = oriented(first, second, 0, noise=0.0)
    scale = 1 / np.abs(base).max()
    np.testing.assert_allclose(found.rotations[1], r, atol=1e-9)
    np.testing.assert_allclose(found.projection_centres[1], scale * np.array(base), atol=1e-8)
    np.testing.assert_allclose(found.model_points, scale * x, atol=1e-7)
    assert found.converged and found.used.all() and found.in_front.all() and np.abs(found.parallaxes).max() < 1e-9


def test_both_orientations_of_a_plane_are_found():
    """With motion towards a plane its false twin is possible too; rounding decides which of the two is first."""
    first, second, r, _ = pair(3, FORWARD, relief=0.0)
    found = oriented(first, second, 0, noise=0.0)
    assert found.ambiguous and found.words.startswith("another orientation fits the points as well")
    both = np.array([found.rotations[1], found.other_rotation])
    errors = np.abs(both - r).max((1, 2))
    assert errors.min() < 1e-9 and errors.max() > 1e-3
    assert found.converged and found.used.all() and found.in_front.all() and np.abs(found.parallaxes).max() < 1e-9


def test_flat_ground_has_a_false_twin_that_is_not_chosen():
    for seed in range(15):
        first, second, r, _ = pair(seed, relief=0.0)
        found = oriented(first, second, seed)
        assert np.abs(found.rotations[1] - r).max() < 5e-3, seed


def test_forward_motion():
    first, second, r, _ = pair(1, FORWARD)
    found = oriented(first, second, 1)
    assert found.names[:2] == ("bx", "by") and found.words == ""
    np.testing.assert_allclose(found.rotations[1], r, atol=5e-3)


def test_thirty_percent_of_wrong_points():
    for seed in range(5):
        first, second, r, _ = pair(seed)
        wrong, rng = np.arange(POINTS) < 12, np.random.default_rng(seed)
        second[wrong] = rng.uniform(-60, 60, (12, 2))
        found = oriented(first, second, seed)
        assert np.abs(found.rotations[1] - r).max() < 5e-3 and found.words == ""
        assert (found.used & wrong).sum() <= 1 and (found.used & ~wrong).sum() >= 26


def test_rotation_without_base_is_told():
    first, second, r, _ = pair(2, (0.0, 0.0, 0.0))
    found = oriented(first, second, 2)
    assert found.parallel and "there is no base" in found.words
    np.testing.assert_allclose(found.rotations[1], r, atol=2e-3)


def test_points_that_have_nothing_in_common_are_told():
    first, second = np.random.default_rng(0).uniform(-60, 60, (2, POINTS, 2))
    assert "points fit one orientation" in oriented(first, second, 0).words


def test_translation_of_a_long_lens():
    """The case of OpenCV's issue 17348: an object of 20 cm in 1 m, c = 11365 px."""
    rng, c = np.random.default_rng(0), 11365.0
    x = rng.uniform(-0.1, 0.1, (POINTS, 3)) * [1, 1, 0.1] - [0, 0, 1]
    base = np.array([-0.035, 0.013, 0.01])
    first, second = (-c * p[:, :2] / p[:, 2:] + 0.1 * rng.standard_normal((POINTS, 2)) for p in (x, x - base))
    found = padded([c, 0, 0, 1, 1], first, second, 0.1)
    b = found.projection_centres[1] / np.linalg.norm(found.projection_centres[1])
    assert np.degrees(np.arccos(b @ base / np.linalg.norm(base))) < 2.0
    np.testing.assert_allclose(found.rotations[1], np.eye(3), atol=5e-3)


def test_published_translation_of_a_long_lens(shared_data):
    """Three measured pairs of the same issue: without rotation they meet at a base across the view.

    The base that was returned there, (1, -1, 1) / sqrt 3, has y-parallaxes of hundreds of pixels."""
    data = example(shared_data, "essential_opencv17348")
    c, middle = data["f"], np.array(data["pp"])
    xy = [(np.array(data[name]) - middle) * [1, -1] for name in ("x1", "x2")]
    first, second = (np.c_[v / c, -np.ones(3)] for v in xy)
    covariance = np.tile(np.eye(2) / c**2, (3, 1, 1))
    rays = Rays(*map(jnp.asarray, (first, second, covariance, covariance, np.ones(3, bool))))
    shift = (xy[1] - xy[0]).mean(0)
    across = jnp.array([*shift, 0.0]) / np.linalg.norm(shift)
    assert np.abs(parallaxes(Pair(jnp.eye(3), across), rays)).max() < 1.0  # px
    returned = jnp.array([1.0, 1.0, -1.0]) / np.sqrt(3)  # y up, axis backwards
    assert np.abs(parallaxes(Pair(jnp.eye(3), returned), rays)).min() > 100


@pytest.mark.thorough
def test_five_points_have_several_orientations():
    """All fit exactly, except for rounding, which does not choose; some have points behind a photograph."""
    several = 0
    for seed in range(6):
        first, second, r, _ = pair(seed, points=5)
        found = relative_orientation(DISTORTION_FREE, INTERIOR, first, second, NOISE)
        assert np.isnan(found.sigma0) and found.ambiguous == ("another orientation" in found.words)
        several += int(found.ambiguous)
        offered = [found.rotations[1], found.other_rotation] if found.ambiguous else [found.rotations[1]]
        assert min(np.abs(rotation - r).max() for rotation in offered) < 1e-9
    assert several >= 4


def test_independent_elements_give_the_same_model():
    first, second, *_ = pair(4)
    one = oriented(first, second, 4)
    two = oriented(first, second, 4, convention="independent", base=2.0)
    assert two.names == ("phi1", "kappa1", "omega2", "phi2", "kappa2")
    np.testing.assert_allclose(two.projection_centres[1], [2, 0, 0], atol=1e-12)
    scale = np.linalg.norm(one.projection_centres[1]) / 2
    np.testing.assert_allclose(scale * two.model_points @ two.rotations[0], one.model_points, atol=1e-9)
    np.testing.assert_allclose(two.parallaxes, one.parallaxes, atol=1e-9)


@pytest.mark.thorough
def test_two_cameras():
    """A distorted projection in the second image."""
    _, _, r, x = pair(5, (1.0, 0, 0))
    p = ((x - [1.0, 0, 0]) @ r).T

    def residual(measured):
        return jnp.stack(BAL.residual(tuple(BAL_INTERIOR), tuple(p[:, k]), tuple(measured)))

    second = np.zeros((POINTS, 2))
    for k in range(POINTS):
        second[k] = -np.linalg.solve(jax.jacfwd(residual)(jnp.zeros(2)), residual(jnp.zeros(2)))
    found = relative_orientation(
        DISTORTION_FREE, INTERIOR, image(x), second, NOISE, second_camera=(BAL, BAL_INTERIOR), samples=SAMPLES
    )
    np.testing.assert_allclose(found.rotations[1], r, atol=1e-8)


@pytest.mark.thorough
def test_scatter_is_the_covariance():
    """Many draws at once; a point is left out, whose coordinates are not numbers."""
    first, second, _, x = pair(6, (1.0, 0, 0), points=16)
    draws, rng = 150, np.random.default_rng(0)
    sigmas = np.where(np.arange(16) == 3, np.inf, NOISE)[:, None] * np.ones(2)
    a, b = (xy + NOISE * rng.standard_normal((draws, 16, 2)) for xy in (first, second))
    a[:, 3] = np.nan

    @jax.jit
    @jax.vmap
    def found(a, b):
        return relative_orientation(DISTORTION_FREE, INTERIOR, a, b, sigmas, samples=8, robust=False)

    f = found(a, b)
    truth = relative_orientation(DISTORTION_FREE, INTERIOR, first, second, sigmas, samples=8, robust=False)
    d = np.asarray(f.elements) - np.asarray(truth.elements)
    good = np.abs(d).max(1) < 0.1  # a start from 8 samples may fail
    assert good.mean() > 0.95 and not f.used[:, 3].any() and (f.redundancy == 10).all()
    squares = np.einsum("ki,kij,kj->k", d, np.linalg.inv(np.asarray(f.cofactors)), d)[good]
    assert squares.mean() == pytest.approx(5.0, abs=4 * np.sqrt(10 / draws))
    assert (np.asarray(f.sigma0)[good] ** 2).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 10 / draws))
    others = np.arange(16) != 3
    e = np.asarray(f.model_points)[good][:, others] - x[others]
    q = np.asarray(f.model_cofactors)[good][:, others]
    squares = np.einsum("kpi,kpij,kpj->kp", e, np.linalg.inv(q), e)
    assert squares.mean() == pytest.approx(3.0, abs=0.25)


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"first": np.zeros((4, 2)), "second": np.zeros((4, 2))}, "4 common points do not determine a relative"),
        ({"second": np.zeros((6, 2))}, r"shapes \(8, 2\) and \(6, 2\); give"),
        ({"interior": np.zeros(3)}, r"shape \(3,\); give principal_distance"),
        ({"first": np.full((8, 2), np.nan)}, "an image coordinate is not a finite number"),
        ({"sigmas": -1.0}, "a sigma is not positive"),
        ({"convention": "free"}, "the convention is"),
    ],
)
def test_bad_input(change, message):
    given = {"interior": INTERIOR, "first": np.zeros((8, 2)), "second": np.zeros((8, 2)), **change}
    with pytest.raises(ValueError, match=message):
        relative_orientation(DISTORTION_FREE, **given)
