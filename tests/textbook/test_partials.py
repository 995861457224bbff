"""The 18 partials of (163) and the matrix (164): what holds, what does not, and that a mistake is found and named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.geometry.rotation import from_alpha_omega_kappa
from jaxbundle.numerics.float64 import require_float64
from jaxbundle.textbook import crosscheck, orthonormality_defect, printed_matrix, printed_partials, regular_partials
from jaxbundle.textbook.cross_checks import THRESHOLD
from jaxbundle.textbook.partials import NAMES

DRAWS = 4000
OF_ANY_MATRIX = [name for name in NAMES if name[1] in "123789"]


@pytest.fixture(scope="module")
def check():
    return crosscheck(draws=DRAWS)


def names(flags):
    return [name for name, flag in zip(NAMES, flags, strict=True) if flag]


def with_error(name, error):
    """The printed formulas with one of them altered, as a reader might copy them."""

    def partials(rotation, angles, projection_centre, object_point, principal_distance):
        values = list(printed_partials(rotation, angles, projection_centre, object_point, principal_distance))
        values[NAMES.index(name)] = error(values[NAMES.index(name)])
        return tuple(values)

    return partials


def test_all_printed_partials_hold_with_the_corrected_matrix(check):
    assert check.passed
    assert check.ordinary.deviations.shape == (3, 18)
    assert (check.ordinary.deviations < THRESHOLD).all()
    assert "All 18 partials are correct as printed" in check.verdict()


def test_the_form_without_division_by_zero_holds_everywhere(check):
    assert (check.regular.deviations < THRESHOLD).all()
    assert (check.regular_singular.deviations < THRESHOLD).all()


def test_the_print_loses_a5_and_b5_at_the_singular_attitude(check):
    assert names(~check.singular.holds) == ["A5", "B5"]
    assert "A5, B5 lose their digits" in check.verdict()


@pytest.mark.parametrize("omega", [np.pi / 2, -np.pi / 2])
def test_a_horizontal_camera_along_the_y_axis(omega):
    """One ray by hand: alpha = kappa = 0, a point straight ahead; dx/dalpha = -f b2, dy/domega = -f."""
    angles = (jnp.asarray(0.0), jnp.asarray(omega), jnp.asarray(0.0))
    rotation, centre, f = from_alpha_omega_kappa(*angles), (5.0, 7.0, 2.0), 60.0
    point = (5.0, 7.0 + 40.0 * np.sign(omega), 2.0)
    partials = dict(zip(NAMES, regular_partials(rotation, angles, centre, point, f), strict=True))
    expected = {"A4": 0.0, "A5": 0.0, "A6": 0.0, "B4": 0.0, "B5": -f, "B6": 0.0}
    assert {name: float(partials[name]) for name in expected} == pytest.approx(expected, abs=1e-12)


def test_the_printed_matrix_is_wrong_in_four_elements(check):
    assert check.matrix.wrong == ("a2", "a3", "b3", "c2")
    assert check.matrix.printed_defect > 1
    assert check.matrix.corrected_defect < 1e-14
    for correction in (
        "a2 = -cos a sin k - sin a sin w cos k",
        "a3 = -sin a cos w",
        "b3 = -sin w",
        "c2 = -sin a sin k + cos a sin w cos k",
    ):
        assert correction in check.verdict()


@pytest.mark.parametrize("angles, defect, digits", [((0.01, 0.01, 0.01), 0.020, 3), ((0.1, -0.2, 0.3), 0.46, 2)])
def test_published_defects_of_the_printed_matrix(angles, defect, digits):
    assert round(float(orthonormality_defect(printed_matrix(*angles))), digits) == defect
    assert float(orthonormality_defect(from_alpha_omega_kappa(*angles))) < 1e-15


def test_with_the_printed_matrix_only_shifts_hold(check):
    assert names(check.with_printed_matrix.holds) == OF_ANY_MATRIX
    assert "With the matrix as printed A4, A5, A6, B4, B5, B6 are not correct." in check.verdict()


@pytest.mark.parametrize("name", ["A1", "A5", "A6", "B4", "B9"])
def test_a_planted_sign_error_is_found_and_named(name):
    check = crosscheck(with_error(name, lambda value: -value), draws=DRAWS)
    assert not check.passed
    assert names(~check.ordinary.holds) == names(check.ordinary.wrong_sign) == [name]
    assert check.ordinary.worst[NAMES.index(name)] > 0.1
    assert "17 of the 18 partials are correct as given" in check.verdict()
    assert f"  {name} d" in check.verdict() and "has the opposite sign; correct:" in check.verdict()


@pytest.mark.parametrize("error", [lambda v: v * (1 + 1e-10), lambda v: v + 1e-6, lambda v: v * np.nan, lambda _: 0.0])
def test_other_errors_are_found(error):
    check = crosscheck(with_error("B2", error), draws=DRAWS)
    assert names(~check.ordinary.holds) == ["B2"]
    assert "B2 dy/dY0 deviates by" in check.verdict()


def test_formulas_may_be_written_in_numpy():
    def partials(rotation, angles, projection_centre, object_point, principal_distance):
        values = list(regular_partials(rotation, angles, projection_centre, object_point, principal_distance))
        f, x, y = (np.asarray(a) for a in (principal_distance, -values[NAMES.index("B6")], values[NAMES.index("A6")]))
        sk, ck = np.sin(angles[2]), np.cos(angles[2])
        values[NAMES.index("A5")] = -f * sk - x / f * (x * sk + y * ck)
        return tuple(values)

    assert crosscheck(partials, draws=DRAWS).passed


def test_the_same_seed_gives_the_same_table(check):
    assert check.table() == crosscheck(draws=DRAWS, seed=0).table()
    assert check.table() != crosscheck(draws=DRAWS, seed=1).table()


@pytest.mark.parametrize("partials", [None, lambda *_: (0.0,) * 18])
def test_the_text_fits_a_terminal(partials):
    check = crosscheck(partials, draws=DRAWS)
    lines = [*check.table().splitlines(), *check.verdict().splitlines()]
    assert max(map(len, lines)) <= 100
    assert all(any(line.startswith(f"{name} d") for line in lines) for name in NAMES)


def test_link_between_the_two_forms_of_a5():
    """tan w + dY / (Z* cos w) = -(x sin k + y cos k) / f."""
    rng = np.random.default_rng(4)
    angles = tuple(jnp.asarray(a) for a in rng.uniform(-1.4, 1.4, (3, 500)))
    centre, point = tuple(jnp.zeros((3, 500))), tuple(jnp.asarray(rng.uniform(-1.0, 1.0, (3, 500)) - 2.0))
    p, f = photo_vector(from_alpha_omega_kappa(*angles), centre, point), 0.7
    x, y = -f * p[0] / p[2], -f * p[1] / p[2]
    printed = jnp.tan(angles[1]) + point[1] / (p[2] * jnp.cos(angles[1]))
    np.testing.assert_allclose(-(x * jnp.sin(angles[2]) + y * jnp.cos(angles[2])) / f, printed, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("formulas", [printed_partials, regular_partials])
def test_partials_take_and_give_scalars(formulas):
    angles = (0.1, -0.2, 0.3)
    rotation = tuple(float(element) for element in from_alpha_omega_kappa(*angles))
    values = formulas(rotation, angles, (0.0, 0.0, 750.0), (100.0, 50.0, 3.0), 70.0)
    assert len(values) == 18
    assert all(jnp.shape(value) == () for value in values)


def test_a_wrong_number_of_partials_is_told():
    with pytest.raises(ValueError, match="the partials are 17 values; return 18"):
        crosscheck(lambda *arguments: printed_partials(*arguments)[:17], draws=DRAWS)


def test_no_rays_are_told():
    with pytest.raises(ValueError, match="draws is 0"):
        crosscheck(draws=0)


def test_single_precision_is_refused_with_the_cure():
    require_float64()
    with jax.enable_x64(False), pytest.raises(ValueError, match='jax.config.update."jax_enable_x64", True.'):
        crosscheck(draws=10)
