"""One photograph: direct linear transformation, points in a plane, the textbook's resection."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbundle as jb
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA, OMEGA_PHI_KAPPA
from jaxbundle.orientation.two_images import eight_points, seven_points

CENTRE, ANGLES = np.array([12.0, -7.0, 90.0]), np.array([0.1, -0.2, 0.7])
INTERIOR = np.array([150.0, 1.5, -0.5, 1.0, 1.0])
NONE = jb.cameras.CAMERA_MODELS["none"]


def rotation(angles: np.ndarray) -> np.ndarray:
    return np.stack([np.asarray(x) for x in OMEGA_PHI_KAPPA.rotation_from_angles(*angles)]).reshape(3, 3)


def image(points: np.ndarray, c: float = 150.0, c2: float = 150.0, x0: float = 1.5, y0: float = -0.5) -> np.ndarray:
    p = (points - CENTRE) @ rotation(ANGLES)
    return np.c_[x0 - c * p[:, 0] / p[:, 2], y0 - c2 * p[:, 1] / p[:, 2]]


def space(count: int = 12) -> np.ndarray:
    return np.random.default_rng(0).uniform([-30, -40, -8], [40, 30, 12], (count, 3))


def test_direct_linear_transformation_returns_the_truth():
    found = jb.orientation.direct_linear_transformation(space(), image(space(), 150.0, 148.0))
    np.testing.assert_allclose(found.projection_centre, CENTRE, rtol=1e-9)
    np.testing.assert_allclose(found.angles, ANGLES, rtol=1e-8)
    np.testing.assert_allclose(found.principal_distances, [150.0, 148.0], rtol=1e-9)
    np.testing.assert_allclose([found.skew, *found.principal_point], [0.0, 1.5, -0.5], atol=1e-7)
    assert bool(found.determined) and found.words == ""


def test_scatter_of_the_direct_linear_transformation_is_its_covariance():
    points, exact, rng = space(), image(space()), np.random.default_rng(1)
    draws = [
        jb.orientation.direct_linear_transformation(points, exact + rng.normal(0, 0.01, exact.shape), 0.01)
        for _ in range(150)
    ]
    elements = np.array([[*d.principal_distances, d.skew, *d.principal_point, *d.projection_centre] for d in draws])
    predicted = np.sqrt(np.diagonal(draws[0].cofactors))[:8]
    np.testing.assert_allclose(elements.std(0), predicted, rtol=0.25)
    assert np.mean([float(d.sigma0) ** 2 for d in draws]) == pytest.approx(1, abs=0.1)


def test_points_in_a_plane_are_told():
    points = space()
    points[:, 2] = 0.2 * points[:, 0]
    found = jb.orientation.direct_linear_transformation(points, image(points))
    assert not bool(found.determined)
    assert "lie in a plane" in found.words


def test_a_mirrored_image_is_told():
    found = jb.orientation.direct_linear_transformation(space(), image(space()) * [1.0, -1.0])
    assert bool(found.mirrored) and "mirrored" in found.words


@pytest.mark.usefixtures("unchecked_types")  # shapes that do not fit
@pytest.mark.parametrize(
    ("points", "xy", "message"),
    [
        (space(5), image(space(5)), "5 points do not determine"),
        (space(), image(space())[:5], "give X, Y, Z"),
        (space() * np.nan, image(space()), "not a finite number"),
    ],
)
def test_bad_input(points, xy, message):
    with pytest.raises(ValueError, match=message):
        jb.orientation.direct_linear_transformation(points, xy)


def test_four_points_of_a_plane():
    square = np.array([[-20.0, -15, 1], [22, -14, 1], [18, 16, 1], [-19, 15, 1]])
    found = jb.orientation.planar_resection(NONE, INTERIOR, square, image(square))
    np.testing.assert_allclose(found.better.projection_centre, CENTRE, rtol=1e-7)
    np.testing.assert_allclose(found.better.angles, ANGLES, rtol=1e-6)
    assert float(found.ratio) > 100 or not np.isfinite(float(found.ratio))


def test_a_small_plane_has_two_orientations():
    """Both are minima of the residuals; a plane of twice the size has one only."""
    square = np.array([[-3.0, -2.5, 0], [3, -3, 0], [2.5, 3, 0], [-3, 3, 0]])
    noise = np.random.default_rng(3).normal(0, 0.005, (4, 2))
    found = jb.orientation.planar_resection(NONE, INTERIOR, square, image(square) + noise, 0.005)
    assert bool(found.better.converged) and bool(found.other.converged) and found.ratio > 5
    assert np.linalg.norm(np.asarray(found.better.projection_centre) - CENTRE) < 2
    assert np.linalg.norm(np.asarray(found.other.projection_centre) - CENTRE) > 10
    alone = jb.orientation.planar_resection(NONE, INTERIOR, 2 * square, image(2 * square) + noise, 0.005)
    assert bool(alone.better.converged) and not bool(alone.other.converged)


def test_points_on_a_line_or_in_space_are_no_plane():
    line = np.c_[np.arange(5.0), np.zeros((5, 2))]
    with pytest.raises(ValueError, match="on a line"):
        jb.orientation.planar_resection(NONE, INTERIOR, line, image(line))
    with pytest.raises(ValueError, match="not lie in a plane"):
        jb.orientation.planar_resection(NONE, INTERIOR, space(), image(space()))
    with pytest.raises(ValueError, match="3 points of a plane"):
        jb.orientation.planar_resection(NONE, INTERIOR, space(3), image(space(3)))


@pytest.mark.thorough
def test_textbook_resection(shared_data):
    """Four control points of a course in photogrammetry, all printed digits."""
    example = json.loads((shared_data / "approximate" / "resection_wuhan.json").read_text())
    points, xy = np.array(example["object_m"]), np.array(example["image_mm"])
    found = jb.orientation.resection(
        NONE, np.array([example["f_mm"], 0, 0, 1, 1]), points, xy, system=ALPHA_OMEGA_KAPPA
    )
    published = example["published"]
    np.testing.assert_allclose(found.projection_centre, [published[k] for k in ("X0", "Y0", "Z0")], atol=0.01)
    np.testing.assert_allclose(found.angles, [published[k] for k in ("phi", "omega", "kappa")], atol=1e-4)
    assert float(found.sigma0) == pytest.approx(example["computed_here"]["s0_mm"], rel=1e-5)
    np.testing.assert_allclose(found.standard_deviations, example["computed_here"]["sd"], rtol=1e-5)


def test_eight_points(shared_data):
    example = json.loads((shared_data / "approximate" / "eight_point_colmap.json").read_text())
    e = np.asarray(eight_points(jnp.array(example["x1"]), jnp.array(example["x2"])))
    expected = np.array(example["E"])
    scale = np.sum(e * expected) / np.sum(e * e)
    np.testing.assert_allclose(scale * e, expected, atol=1e-5)


def test_seven_points(shared_data):
    """COLMAP's example, whose one real solution was computed by Matlab."""
    example = json.loads((shared_data / "approximate" / "seven_point_colmap.json").read_text())
    f, real = (np.asarray(x) for x in seven_points(jnp.array(example["x1"]), jnp.array(example["x2"])))
    (found,) = f[real]
    np.testing.assert_allclose(found / found[2, 2], np.array(example["F"]), atol=1e-6)
