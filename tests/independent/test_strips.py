"""Independent strips: polynomials, demanded control, joints and corrections."""

import numpy as np
import pytest

from jaxbundle.independent.control_layout import Supported, missing_control
from jaxbundle.independent.polynomials import correction, curbed, elements, strip_sensor

FORMS = [("separate", 2), ("separate", 3), ("plan-conformal", 2), ("plan-conformal", 3), ("conformal", 2)]


@pytest.mark.parametrize(
    ("form", "degree", "number"), [(*f, n) for f, n in zip(FORMS, (15, 21, 11, 15, 10), strict=True)]
)
def test_numbers_of_coefficients(form, degree, number):
    names = elements(form, degree)
    assert len(names) == len(set(names)) == number
    assert set(curbed(form, degree)) <= set(names)
    assert strip_sensor(form, degree) is strip_sensor(form, degree)


def test_plan_conformal_is_a_complex_polynomial():
    rng = np.random.default_rng(1)
    c, z = rng.normal(size=15), complex(*rng.normal(size=2))
    dx, dy, _ = correction("plan-conformal", 3, tuple(c), (z.real, z.imag, 0.3, 0.7))
    expected = sum(complex(c[2 * k], c[2 * k + 1]) * z**k for k in range(4))
    assert complex(dx, dy) == pytest.approx(expected)


def test_conformal_in_space_is_a_similarity_everywhere(unchecked_types):
    """To first order of the coefficients: the symmetric part of the derivatives is a multiple of the unit matrix."""
    rng = np.random.default_rng(2)
    c, at = tuple(rng.normal(size=10)), rng.normal(size=3)
    step = 1e-20  # imaginary, which the types do not allow: derivatives of polynomials without rounding
    along = [correction("conformal", 2, c, (*(at + 1j * step * e), 0.0)) for e in np.eye(3)]
    j = np.imag(np.array(along)).T / step
    symmetric = (j + j.T) / 2
    np.testing.assert_allclose(symmetric, symmetric[0, 0] * np.eye(3), atol=1e-12)


def _supported(places: list[tuple[float, float]], ties: int = 0, stations: bool = False) -> Supported:
    along, across = np.array(places).T
    control = np.ones(len(along), bool)
    along, across = (np.concatenate([x, np.full(ties, y)]) for x, y in ((along, 0.0), (across, -0.8)))
    control = np.concatenate([control, np.zeros(ties, bool)])
    return Supported(along, across, control, ~control, np.linspace(-1, 1, 5) if stations else np.zeros(0))


def test_demanded_control():
    ends = [(-0.9, 0.8), (-0.9, -0.8), (0.9, 0.8), (0.9, -0.8)]
    (missing,) = missing_control("strip 1", _supported(ends), 3)
    assert missing.words == (
        "strip 1 has no control on both edges in its middle (from 33 to 67 % of its length), which polynomials of"
        " degree 2 need;"
        " add points with X, Y, Z there, or adjust by models"
    )
    middle = [*ends, (0.0, 0.8)]
    (missing,) = missing_control("strip 1", _supported(middle), 3)
    assert "on the right edge in its middle" in missing.words
    assert not missing_control("strip 1", _supported(middle, ties=2), 3)
    assert not missing_control("strip 1", _supported(middle, stations=True), 3)
    assert len(missing_control("strip 1", _supported(ends), 4)) == 2


def test_points_are_named_where_control_is_missing():
    places = [(-0.9, 0.8), (-0.9, -0.8), (0.9, 0.8), (0.9, -0.8), (0.1, 0.9), (0.3, 0.9), (0.0, 0.0)]
    plan = 1000.0 + 100.0 * np.array(places)
    supported = _supported(places)._replace(control=np.arange(7) < 4, tie=np.zeros(7, bool))
    (missing,) = missing_control("strip 1", supported._replace(names=tuple("ABCDEFG"), plan=plan), 3)
    assert "such as E near 1010, 1090, or adjust by models" in missing.words
