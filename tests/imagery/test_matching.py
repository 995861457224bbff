"""Least-squares matching: no bias, the precision it predicts, refusals with their reasons, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.textures import Waves, box, cut, grey_image, interest_points, pixel_centres
from scipy import ndimage

from jaxbundle.imagery import spline
from jaxbundle.imagery.match_types import MatchOptions, Refusal
from jaxbundle.imagery.matching import Pair, match, normal_equations, residuals

HALF, MARGIN = 5, 12  # windows of 11 x 11, searched in 35 x 35: one program for all tests
AFFINE = MatchOptions(parameters="affine")


def starts(number, x, y):
    return np.tile([x, 1.0, 0.0, y, 0.0, 1.0], (number, 1))


def in_the_middle(number):
    return np.full((number, 2), HALF + 0.5)


def test_spline_equals_scipy():
    image = np.random.default_rng(1).uniform(0, 255, (31, 27))
    x, y = np.random.default_rng(2).uniform(2, 25, (2, 400))
    filtered = ndimage.spline_filter(image, 3, mode="mirror")

    def scipy_value(x, y):
        return ndimage.map_coordinates(filtered, [y - 0.5, x - 0.5], order=3, mode="mirror", prefilter=False)

    surface = spline.coefficients(jnp.asarray(image))
    np.testing.assert_allclose(surface, filtered, rtol=1e-9, atol=1e-9)
    values, slopes = jax.jvp(lambda x: spline.value(surface, x, jnp.asarray(y)), (jnp.asarray(x),), (jnp.ones(400),))
    np.testing.assert_allclose(values, scipy_value(x, y), atol=1e-6)
    away = np.abs((x - 0.5) - np.round(x - 0.5)) > 0.03  # third derivatives jump at the knots
    step = 0.01  # between knots this formula of fourth order is exact for a cubic polynomial

    def central(step):
        return (scipy_value(x + step, y) - scipy_value(x - step, y)) / (2 * step)

    np.testing.assert_allclose(slopes[away], ((4 * central(step) - central(2 * step)) / 3)[away], atol=1e-6)


def test_too_small_windows_have_no_spline():
    with pytest.raises(ValueError, match="3 px is too small"):
        spline.prefilter(3)


@pytest.fixture(scope="module")
def sand(shared_data):
    return grey_image(shared_data / "images" / "copr" / "IMG_0052.jpg")


def shifted(sand, options, half=HALF, number=60, shifts=(0, 2, 4, 6)):
    """Errors for shifts of eighths of a pixel, which are exact, with noise of one grey value; sigmas; iterations."""
    rng = np.random.default_rng(0)
    base = box(sand, 8, 0)
    noisy = base + rng.standard_normal(base.shape)
    rows, columns = interest_points(base, half, half + 14, number)
    errors, sigmas, iterations = [], [], []
    for right in (0, 2, 4, 6):
        other = box(sand, 8, right)
        other = other + rng.standard_normal(other.shape)
        if right not in shifts:
            continue
        found = match(
            cut(noisy, rows, columns, half),
            cut(other, rows, columns, MARGIN + half),
            np.full((len(rows), 2), half + 0.5),
            starts(len(rows), MARGIN + half + 0.5, MARGIN + half + 0.5),
            options,
        )
        good = found.matched
        errors.append(np.asarray(found.position)[good] - (MARGIN + half + 0.5) + [right / 8, 0])
        sigmas.append(np.asarray(found.sigmas)[good])
        iterations.append(np.asarray(found.iterations)[good])
    return np.concatenate(errors), np.concatenate(sigmas), np.concatenate(iterations)


def test_no_bias_and_the_predicted_precision(sand):
    errors, sigmas, iterations = shifted(sand, AFFINE)
    assert len(errors) > 230
    assert np.abs(np.mean(errors)) < 0.003
    assert 0.85 < np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.2
    assert iterations.mean() <= 6


@pytest.mark.thorough
def test_shift_of_larger_windows(sand):
    errors, sigmas, _ = shifted(sand, MatchOptions(parameters="shift"), half=10, number=30)
    assert len(errors) == 120
    assert np.abs(errors.mean(0)).max() < 0.003
    assert errors.std() < 0.016
    assert np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.4


@pytest.mark.thorough
def test_bilinear_interpolation_has_a_bias(sand):
    """Negative control: the same test sees the bias that the spline does not have."""
    bias = {}
    for interpolation in ("bilinear", "spline"):
        options = MatchOptions(parameters="shift", interpolation=interpolation, max_iterations=60)
        errors, *_ = shifted(sand, options, shifts=(6,))
        bias[interpolation] = np.abs(errors.mean(0)).max()
    assert bias["bilinear"] > 0.02
    assert bias["spline"] < 0.01


def warped(number, noise, seed, half=HALF, around=0):
    """Windows of a texture and of its warp by 5 deg and a scale of 1.05; and the true affine parameters.

    `around`: px around the templates.
    """
    gain, offset = 0.9, 10.0
    rng, waves = np.random.default_rng(seed), Waves(seed)
    a = 1.05 * np.array([[np.cos(0.0873), -np.sin(0.0873)], [np.sin(0.0873), np.cos(0.0873)]])
    shift = rng.uniform(-0.5, 0.5, (number, 2))
    size = 2 * (half + MARGIN) + 1
    templates, searched = [], []
    for k in range(number):
        place = rng.uniform(-500, 500, 2)
        templates.append(waves(*pixel_centres(2 * (half + around) + 1, (place[0], place[1]))))
        x, y = pixel_centres(size)
        back = np.linalg.solve(a, np.stack([(x - shift[k, 0]).ravel(), (y - shift[k, 1]).ravel()]))
        searched.append((waves(*(back + place[:, None])) - offset).reshape(size, size) / gain)
    templates, searched = np.array(templates), np.array(searched)
    templates += noise * rng.standard_normal(templates.shape)
    searched += noise * rng.standard_normal(searched.shape)
    return templates, searched, shift, a


def test_warp_of_known_parameters():
    templates, searched, shift, a = warped(200, 0.5, 5)
    middle = HALF + MARGIN + 0.5
    found = match(templates, searched, in_the_middle(200), starts(200, middle, middle), AFFINE)
    good = found.matched
    assert good.mean() > 0.97
    errors = np.asarray(found.position)[good] - middle - shift[good]
    z = errors / np.asarray(found.sigmas)[good]
    assert np.abs(errors.mean()) < 0.002
    assert 0.9 < np.sqrt(np.mean(z**2)) < 1.2
    assert np.mean(np.abs(z) < 3) > 0.98
    scale = np.sqrt(np.linalg.det(np.asarray(found.affine)[good]))
    assert np.abs(scale.mean() - 1.05) < 5e-4
    assert np.asarray(found.iterations)[good].mean() <= 6
    assert np.asarray(found.radiometry)[good].mean(0) == pytest.approx([10.0, 0.9], abs=0.5)


def sigmas_of_all(templates, searched, references, found):
    """Standard deviations of a0, a1, a2, b0, b1, b2, r0, r1 at the solution, from their normal equations."""

    def sigmas(p, template, searched, reference):
        pair = Pair(template, searched, reference, p[:6])
        normals, _, total = normal_equations(p, pair, spline.coefficients(searched), False)
        scale = 1 / jnp.sqrt(jnp.diagonal(normals))
        cofactors = jnp.diagonal(jnp.linalg.inv(normals * scale[:, None] * scale[None]))
        return scale * jnp.sqrt(total / (template.size - 8) * cofactors)

    a = np.asarray(found.affine)
    position, radiometry = np.asarray(found.position), np.asarray(found.radiometry)
    p = np.concatenate([position[:, :1], a[:, 0], position[:, 1:], a[:, 1], radiometry], 1)
    return p, np.asarray(jax.jit(jax.vmap(sigmas))(p, templates, searched, references))


@pytest.fixture(scope="module")
def large_windows():
    """200 windows of 21 x 21 and their warps, matched."""
    templates, searched, shift, a = warped(200, 0.5, 5, 10)
    middle, references = 10 + MARGIN + 0.5, np.full((200, 2), 10.5)
    found = match(templates, searched, references, starts(200, middle, middle), AFFINE)
    return templates, searched, references, found, shift, a


@pytest.mark.thorough
def test_all_parameters_of_larger_windows(large_windows):
    templates, searched, references, found, shift, a = large_windows
    assert found.matched.all()
    p, sigmas = sigmas_of_all(templates, searched, references, found)
    middle = 10 + MARGIN + 0.5
    true = np.tile([middle, *a[0], middle, *a[1]], (200, 1))
    true[:, [0, 3]] += shift
    z = ((p[:, :6] - true) / sigmas[:, :6]).T
    rms = np.sqrt(np.mean(z**2, 1))
    assert (0.9 < rms).all() and (rms < 1.2).all()
    assert np.mean(np.abs(z) < 3) > 0.99
    scale = np.sqrt(np.linalg.det(np.asarray(found.affine)))
    assert np.abs(scale.mean() - 1.05) < 1e-4
    assert np.asarray(found.iterations).mean() <= 6


@pytest.mark.thorough
def test_template_and_search_exchanged():
    """The same pairs measured both ways.

    With new noise both measurements are independent. In the same pixels most of the noise is common to them.
    """
    whole, searched, *_ = warped(200, 0.0, 5, 10, MARGIN)
    rng, middle = np.random.default_rng(1), 10 + MARGIN + 0.5
    noisy = [[g + 0.5 * rng.standard_normal(g.shape) for g in (whole, searched)] for _ in range(2)]
    inside, column = slice(MARGIN, -MARGIN), np.full((200, 1), middle)
    references = np.full((200, 2), 10.5)
    there = match(noisy[0][0][:, inside, inside], noisy[0][1], references, starts(200, middle, middle), AFFINE)
    corner = np.floor(np.asarray(there.position)).astype(int) - 10
    inverse = np.linalg.inv(np.asarray(there.affine))
    first = np.concatenate([column, inverse[:, 0], column, inverse[:, 1]], 1)
    ratios = []
    for templates, images in ((noisy[0][1], noisy[0][0]), (noisy[1][1], noisy[1][0])):
        windows = np.array([g[y : y + 21, x : x + 21] for g, (x, y) in zip(templates, corner, strict=True)])
        back = match(windows, images, np.asarray(there.position) - corner, first, AFFINE)
        assert (there.matched & back.matched).all()
        difference = (np.asarray(there.affine) @ (np.asarray(back.position) - middle)[..., None])[..., 0]
        predicted = np.sqrt(np.asarray(there.sigmas) ** 2 + np.asarray(back.sigmas) ** 2)
        ratios.append(np.sqrt(np.mean((difference / predicted) ** 2)))
    assert ratios[0] < 0.5
    assert 0.7 < ratios[1] < 1.5


def test_level_1_of_a_shifted_image_is_shifted_by_half(sand):
    first, second = box(sand, 2, 0)[:700, :1000], box(sand, 2, 1)[:700, :1000]  # half a pixel of level 1
    rows, columns = interest_points(first, HALF, 30, 200)
    found = match(
        cut(first, rows, columns, HALF),
        cut(second, rows, columns, HALF + MARGIN),
        in_the_middle(len(rows)),
        starts(len(rows), HALF + MARGIN + 0.5, HALF + MARGIN + 0.5),
        AFFINE,
    )
    shift = np.asarray(found.position)[found.matched] - (HALF + MARGIN + 0.5)
    assert np.abs(np.median(shift, 0) - [-0.5, 0]).max() < 0.01


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_refusals():
    templates, searched, *_ = warped(6, 0.2, 7)
    middle = HALF + MARGIN + 0.5
    first = starts(6, middle, middle)
    templates[0] = 100.0
    searched[1] = np.random.default_rng(1).uniform(0, 255, searched[1].shape)
    first[2, [0, 3]] = 3.0
    searched[3] = 80.0
    found = match(templates, searched, in_the_middle(6), first, AFFINE)
    status = [Refusal(int(s)) for s in np.asarray(found.status)]
    assert Refusal.MATCHED not in status[:4]
    assert status[0] == status[3] == Refusal.NO_TEXTURE
    assert status[4:] == [Refusal.MATCHED] * 2
    assert "texture" in status[0].words


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"shapes \(2, 11, 11\)"):
        match(np.zeros((2, 11, 11)), np.zeros((2, 35, 35)), np.zeros((2, 2)), np.zeros((1, 6)))


def test_normal_equations_are_those_of_the_residuals():
    templates, searched, *_ = warped(1, 0.5, 9)
    pair = Pair(*(jnp.asarray(x[0]) for x in (templates, searched, in_the_middle(1), starts(1, 17.3, 17.4))))
    surface = spline.coefficients(pair.searched)
    p = jnp.concatenate([pair.start, jnp.array([3.0, 0.8])])
    v = jax.jit(lambda p: residuals(p, pair, surface, False))
    steps = 1e-5 * np.eye(8)
    rows = np.stack([(v(p + step) - v(p - step)) / 2e-5 for step in steps])
    normals, right, total = jax.jit(lambda p: normal_equations(p, pair, surface, False))(p)
    np.testing.assert_allclose(normals, rows @ rows.T, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(right, rows @ v(p), rtol=1e-6, atol=1e-3)
    assert total == pytest.approx(float(v(p) @ v(p)))
