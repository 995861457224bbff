"""Space resection: the truth from nothing, the bundle with held points, and never a number that only looks like one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.forward import BAL
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.polynomial import quartic_roots
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA, OMEGA_PHI_KAPPA
from jaxbundle.orientation.resections import Resection, resection
from jaxbundle.planning.simulation import exact_coordinates
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status

INTERIORS = {
    DISTORTION_FREE: np.array([50.0, 2010.0, 1490.0, 0.01, -1.0]),
    BROWN: np.array([50.0, 2010.0, 1490.0, -1e-5, 2e-8, 1e-11, 1e-5, -2e-5, 1e-3, 2e-3, 0.01, -1.0]),
    BAL: np.array([5000.0, -0.3, 0.1]),
}
CENTRE, ANGLES = np.array([20.0, -10.0, 900.0]), np.array([0.2, -0.3, 2.5])
POINTS = np.random.default_rng(0).uniform(-1, 1, (7, 3)) * [300.0, 300.0, 60.0]
NUMBERS = ("projection_centre", "angles", "cofactors", "residuals", "sigma0")


def one_image(points: np.ndarray, model: CameraModel = DISTORTION_FREE, noise: float = 0.0, seed: int = 1) -> Block:
    """A block of one image and held points, and exact image coordinates plus errors; the image starts at the truth."""
    number, elements = len(points), INTERIORS[model][None]
    structure = Structure(
        "one",
        (Camera("camera", model),),
        ("1",),
        tuple(map(str, range(number))),
        np.zeros(1, np.int32),
        np.zeros(number, np.int32),
        np.arange(number, dtype=np.int32),
        np.ones((1, 6), bool),
        np.zeros(elements.shape, bool),
        np.zeros((number, 3), bool),
        np.zeros(0, int),
        Datum("open"),
    )
    block = Block(
        structure,
        ExteriorOrientation(jnp.array([CENTRE]), jnp.array([ANGLES])),
        InteriorOrientation(jnp.asarray(elements)),
        jnp.asarray(points),
        Rays(jnp.zeros((number, 2)), jnp.full((number, 2), 0.5)),
        (),
        CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )
    coordinates, left = exact_coordinates(block)
    assert np.abs(left).max() < 1e-6
    measured = coordinates + noise * np.random.default_rng(seed).standard_normal(coordinates.shape)
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(measured))


def resected(block: Block, **options) -> Resection:
    camera = block.structure.cameras[0]
    rays = block.rays
    return resection(
        camera.model, block.interior.elements[0], block.object_points, rays.coordinates, rays.sigmas, **options
    )


@pytest.mark.parametrize("model", [DISTORTION_FREE, BAL], ids=lambda model: model.name)
@pytest.mark.parametrize("relief", [1, 0], ids=["relief", "plane"])
def test_finds_the_truth_from_nothing(model, relief):
    found = resected(one_image(POINTS * [1, 1, relief], model))
    assert found.converged and found.redundancy == 8 and found.words == "the resection converged"
    np.testing.assert_allclose(found.projection_centre, CENTRE, atol=1e-6)
    np.testing.assert_allclose(found.angles, ANGLES, atol=1e-9)
    assert np.abs(found.residuals).max() < 1e-6


def test_is_the_bundle_with_held_points():
    block = one_image(POINTS, BROWN, noise=0.7)
    full, found = adjust(block), resected(block)
    np.testing.assert_allclose(found.projection_centre, full.block.exterior.projection_centre[0], rtol=1e-9)
    np.testing.assert_allclose(found.angles, full.block.exterior.angles[0], rtol=1e-9)
    np.testing.assert_allclose(found.sigma0, full.sigma0, rtol=1e-9)
    np.testing.assert_allclose(found.residuals, full.residuals[0], atol=1e-6)
    assert full.cofactors is not None
    scale = np.sqrt(np.diagonal(full.cofactors.exterior[0]))
    np.testing.assert_allclose(
        found.cofactors / np.outer(scale, scale), full.cofactors.exterior[0] / np.outer(scale, scale), atol=1e-7
    )
    sd = full.standard_deviations
    np.testing.assert_allclose(found.standard_deviations, np.r_[sd.projection_centre[0], sd.angles[0]], rtol=1e-7)
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.covariance)), found.standard_deviations)


def test_given_start_leads_to_the_same_and_keeps_its_turns():
    block = one_image(POINTS, noise=0.5)
    direct = resected(block)
    turn = np.array([0, 0, 2 * np.pi])
    given = resected(block, start=(CENTRE + 60.0, ANGLES + 0.15 + turn))
    np.testing.assert_allclose(given.projection_centre, direct.projection_centre, rtol=1e-9)
    np.testing.assert_allclose(given.angles, direct.angles + turn, rtol=1e-9)


@pytest.mark.thorough
def test_angles_of_another_system():
    block = one_image(POINTS, noise=0.5)
    direct = resected(block)
    other = resected(block, system=ALPHA_OMEGA_KAPPA)
    np.testing.assert_allclose(
        jnp.stack(ALPHA_OMEGA_KAPPA.rotation_from_angles(*other.angles)),
        jnp.stack(OMEGA_PHI_KAPPA.rotation_from_angles(*direct.angles)),
        atol=1e-10,
    )


def test_three_points_and_a_start_have_no_redundancy():
    found = resected(one_image(POINTS[:3]), start=(CENTRE + 10.0, ANGLES + 0.02))
    np.testing.assert_allclose(found.projection_centre, CENTRE, atol=1e-6)
    assert found.converged and found.redundancy == 0
    assert np.isnan(found.sigma0) and np.isnan(found.standard_deviations).all() and np.isfinite(found.cofactors).all()


def test_large_coordinates():
    block, shift = one_image(POINTS, noise=0.5), np.array([400_000.0, 5_600_000.0, 300.0])
    far = resected(eqx.tree_at(lambda b: b.object_points, block, block.object_points + shift[None]))
    near = resected(block)
    np.testing.assert_allclose(far.projection_centre - shift, near.projection_centre, atol=1e-7)
    np.testing.assert_allclose(far.angles, near.angles, atol=1e-10)


def many(number: int, points: int = 6, noise: float = 0.5) -> tuple[jax.Array, jax.Array, np.ndarray]:
    """Object points, image coordinates and true projection centres of images in all attitudes."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (points, 3, number)) * np.array([300.0, 300.0, 60.0])[:, None]
    angles = rng.uniform(-1, 1, (3, number)) * np.array([0.5, 0.5, np.pi])[:, None]
    rotation = OMEGA_PHI_KAPPA.rotation_from_angles(*angles)
    back = np.array([rotation[2], rotation[5], rotation[8]])  # the camera looks along -z, at the points
    centre = 1000.0 * back + rng.uniform(-50, 50, (3, number))
    on_x, on_y, on_z = jnp.asarray(x).swapaxes(0, 1)
    p = photo_vector(tuple(np.asarray(r)[None] for r in rotation), tuple(centre[:, None]), (on_x, on_y, on_z))
    v = DISTORTION_FREE.residual(tuple(INTERIORS[DISTORTION_FREE]), p, (jnp.zeros(()), jnp.zeros(())))
    measured = np.stack([v[0], -v[1]], -1)  # what the residual is at the point (0, 0); y up, v down
    measured = measured + noise * rng.standard_normal(measured.shape)
    return jnp.asarray(np.moveaxis(x, 2, 0)), jnp.asarray(np.moveaxis(measured, 1, 0)), centre.T


INTERIOR = jnp.asarray(INTERIORS[DISTORTION_FREE])


@pytest.fixture(scope="module")
def over_images():
    """Of 1100 images: more than are taken together, so that they go in parts."""
    return jax.jit(jax.vmap(lambda x, xy, sigmas: resection(DISTORTION_FREE, INTERIOR, x, xy, sigmas)))


def test_many_images_at_once_from_nothing(over_images):
    """Each is as by itself."""
    x, xy, centres = many(1100)
    found = over_images(x, xy, jnp.ones_like(xy))
    assert found.converged.all()
    error = np.abs(found.projection_centre - centres) / found.standard_deviations[:, :3]
    assert np.median(error) == pytest.approx(0.718, abs=0.05)  # Student's t with 6 degrees of freedom
    for k in (0, 700, 1099):
        alone = resection(DISTORTION_FREE, INTERIOR, x[k], xy[k])
        for name in NUMBERS:
            np.testing.assert_allclose(getattr(found, name)[k], getattr(alone, name), rtol=1e-6, atol=1e-8)


def test_over_observations_and_over_cameras():
    """The object points are the same for all."""
    x, xy, _ = many(1)
    draws = xy[:1] + 0.3 * jax.random.normal(jax.random.key(0), (3, 6, 2))
    interiors = INTERIOR[None] + jnp.array([[0.0], [0.05], [-0.05]]) * jnp.eye(5)[:1]
    found = jax.vmap(lambda i, xy: resection(DISTORTION_FREE, i, x[0], xy))(interiors, draws)
    for k in (1, 2):
        alone = resection(DISTORTION_FREE, interiors[k], x[0], draws[k])
        for name in NUMBERS:
            np.testing.assert_allclose(getattr(found, name)[k], getattr(alone, name), rtol=1e-6, atol=1e-8)


def test_points_left_out_by_an_infinite_sigma_have_no_influence():
    """Images of six and of seven points together; what stands in the place of a point that takes no part is nothing."""
    x, xy, _ = many(2)
    padded_x = jnp.concatenate([x, jnp.full((2, 1, 3), jnp.nan)], 1)
    padded_xy = jnp.concatenate([xy, jnp.full((2, 1, 2), jnp.nan)], 1)
    sigmas = jnp.ones((7, 2)).at[6].set(jnp.inf)
    alone = resection(DISTORTION_FREE, INTERIOR, padded_x[1], padded_xy[1], sigmas)
    plain = resection(DISTORTION_FREE, INTERIOR, x[1], xy[1])
    assert alone.redundancy == 6 and not alone.residuals[6].any()
    for name in ("projection_centre", "angles", "cofactors", "sigma0"):
        np.testing.assert_allclose(getattr(alone, name), getattr(plain, name), rtol=1e-6, atol=1e-9)


@pytest.mark.thorough
def test_derivatives_are_differences():
    x, xy, _ = many(1)

    @jax.jit
    def all_of(t):
        found = resection(DISTORTION_FREE, INTERIOR * (1 + t), x[0] + t * jnp.sin(x[0]), xy[0] * (1 + 0.1 * t))
        return jnp.concatenate([found.projection_centre, found.angles, found.standard_deviations, found.sigma0[None]])

    value, derivative = jax.jit(lambda t: jax.jvp(all_of, (t,), (1.0,)))(0.0)
    difference = (8 * (all_of(1e-5) - all_of(-1e-5)) - (all_of(2e-5) - all_of(-2e-5))) / 12e-5
    np.testing.assert_allclose(derivative, difference, rtol=1e-5)
    np.testing.assert_allclose(value, all_of(0.0), rtol=1e-9)


@pytest.mark.thorough
def test_gradients_go_through_vmap_either_way():
    x, xy, _ = many(3)

    @jax.jit
    def height(x, xy):
        return resection(DISTORTION_FREE, INTERIOR, x, xy).projection_centre[2]

    each = jax.jit(jax.vmap(jax.grad(height)))(x, xy)
    of_sum = jax.jit(jax.grad(lambda x: jax.vmap(height)(x, xy).sum()))(x)
    np.testing.assert_allclose(each, of_sum, atol=1e-10)
    step = jnp.zeros_like(x[0]).at[2, 1].set(1e-3)
    difference = (height(x[0] + step, xy[0]) - height(x[0] - step, xy[0])) / 2e-3
    assert each[0, 2, 1] == pytest.approx(float(difference), rel=1e-6)


ON_A_LINE = np.linspace([-250.0, -100.0, 0.0], [250.0, 150.0, 30.0], 7)


@pytest.mark.parametrize("start", [None, (CENTRE + 5.0, ANGLES)], ids=["direct", "start"])
def test_points_on_a_line_give_no_number(start):
    found = resected(one_image(ON_A_LINE, noise=0.3), start=start)
    assert found.status == Status.SINGULAR and not found.converged
    assert all(np.isnan(getattr(found, name)).all() for name in NUMBERS)
    assert "measure four or more that are not on one line" in found.words


def test_a_cross_of_five_points_in_a_plane(over_images):
    """No result that is far off and called a success: the truth, or the reflected plane, with the noise as misfit."""
    cross = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0]]) * 200.0
    rng = np.random.default_rng(3)
    xy = np.asarray(one_image(cross).rays.coordinates) + 0.5 * rng.normal(size=(1100, 6, 2))
    found = over_images(jnp.asarray(np.tile(cross, (1100, 1, 1))), jnp.asarray(xy), jnp.ones(xy.shape))
    assert np.asarray(found.converged).all()
    assert np.abs(np.asarray(found.residuals)).max() < 5  # px
    off = np.linalg.norm(np.asarray(found.projection_centre) - CENTRE, axis=1)
    assert (off < 20).mean() > 0.8


def test_a_bad_image_spoils_no_other(over_images):
    """A line, no numbers, three points, none at all; with four points there is a result."""
    x, xy, _ = many(1100)
    line = np.linspace([-250.0, -100.0, 0.0], [250.0, 150.0, 30.0], 6)
    sigmas = jnp.ones_like(xy).at[3, 3:].set(jnp.inf).at[4, 4:].set(jnp.inf).at[5].set(jnp.inf)
    found = over_images(x.at[1].set(line).at[2].set(jnp.nan), xy, sigmas)
    bad = np.array([1, 2, 3, 5])
    np.testing.assert_array_equal(found.converged, ~np.isin(np.arange(1100), bad))
    assert all(np.isnan(getattr(found, name)[bad]).all() for name in NUMBERS)
    assert found.redundancy[4] == 2 and np.isfinite(found.standard_deviations[4]).all()


def test_an_image_below_its_points_is_no_result():
    """Of points in a plane there is a second solution, mirrored in it, which has the points behind the camera."""
    block = one_image(POINTS * [1, 1, 0])
    below = resected(block, start=(CENTRE * [1, 1, -1], np.array([-0.2, 0.3, 2.5])))
    assert not below.converged and np.isnan(below.projection_centre).all()
    assert "converged" not in below.words.replace("not converged", "")


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_points": POINTS[:2], "coordinates": np.zeros((2, 2))}, "2 points do not determine an image; measure"),
        ({"object_points": POINTS[:3], "coordinates": np.zeros((3, 2))}, "3 points have up to four solutions; measure"),
        ({"coordinates": np.zeros((6, 2))}, r"shape \(7, 3\) and image coordinates of shape \(6, 2\)"),
        ({"interior": np.zeros(3)}, r"shape \(3,\); give principal_distance, x0, y0, pixel_size, y_axis"),
        ({"interior": np.full(5, np.nan)}, "the interior or the start has a value that is not a finite number"),
        ({"sigmas": 0.0}, "a sigma is not positive; give"),
        ({"sigmas": np.where(np.arange(7) < 3, 1.0, np.inf)[:, None]}, "3 points have up to four solutions"),
        ({"object_points": POINTS * [[1, np.nan, 1]]}, "point 1 is not a finite number"),
        ({"coordinates": np.full((7, 2), np.inf)}, "image coordinate 1 is not a finite number"),
        ({"start": (CENTRE, np.zeros(2))}, "a start is a pair"),
    ],
)
def test_bad_input(change, message):
    given = {"interior": INTERIOR, "object_points": POINTS, "coordinates": np.zeros((7, 2)), **change}
    with pytest.raises(ValueError, match=message):
        resection(DISTORTION_FREE, **given)


def test_roots_of_the_fourth_degree():
    a = np.random.default_rng(3).normal(0, 1, (5, 500))
    a[0, :20], a[1:4:2, 20:40] = 1e-6, 0.0  # nearly of third degree, and biquadratic
    expected = np.sort([np.roots(c).real for c in a.T], 1)
    found = np.sort(np.asarray(quartic_roots(tuple(a), jnp.zeros((), int))).T, 1)
    np.testing.assert_array_less(np.abs(found - expected) / (1 + np.abs(expected).max(1, keepdims=True)), 1e-5)
