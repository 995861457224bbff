"""The image equation and the camera models against matrices and formulas written out in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.camera.collinearity import central_projection, collinearity, photo_vector
from jaxbundle.camera.model import BAL, BROWN, CAMERA_MODELS, DISTORTION_FREE, mixture
from jaxbundle.geometry.rotation import from_alpha_omega_kappa, from_omega_phi_kappa

CENTRE, POINT = (100.0, -50.0, 750.0), (310.0, 120.0, 12.5)
ROTATION = from_omega_phi_kappa(0.05, -0.08, 2.1)
PHOTO_VECTOR = (210.0, -170.0, -737.5)

INTERIORS = {
    "none": (153.2, 0.012, -0.031, 1.0, 1.0),
    "brown": (28.4, 1250.0, 840.5, 1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5, 3e-4, -2e-4, 0.0061, -1.0),
    "bal": (1520.4, -0.21, 0.035),
}
MEASURED = {"none": (-43.7, 35.2), "brown": (2480.3, 1920.8), "bal": (-440.1, 350.9)}


def numpy_residual(name, interior, photo_vector, measured):
    """FORMAT of the block folder, section Collinearity, line by line."""
    px, py, pz = photo_vector
    u, v = measured
    if name == "bal":
        f, k1, k2 = interior
        x, y = -px / pz, -py / pz
        r2 = x**2 + y**2
        return f * (1 + k1 * r2 + k2 * r2**2) * x - u, f * (1 + k1 * r2 + k2 * r2**2) * y - v
    c, u0, v0, *coefficients, s, y_axis = interior
    xs, ys = -c * px / pz, -c * py / pz
    x, y = (u - u0) * s, y_axis * (v - v0) * s
    if name == "brown":
        k1, k2, k3, p1, p2, b1, b2 = coefficients
        x1, y1 = (1 + b1) * x + b2 * y, y
        r2 = x1**2 + y1**2
        x = x1 * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) + p1 * (r2 + 2 * x1**2) + 2 * p2 * x1 * y1
        y = y1 * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) + p2 * (r2 + 2 * y1**2) + 2 * p1 * x1 * y1
    return (xs - x) / s, (ys - y) / s


def residual(model):
    @jax.jit
    def stacked(interior, photo_vector, measured):
        return jnp.stack(model.residual(tuple(interior), tuple(photo_vector), tuple(measured)))

    return stacked


def padded(name, number):
    """The interior as a mixture of the three models wants it."""
    interior = INTERIORS[name]
    length = max(len(model.elements) for model in CAMERA_MODELS.values())
    return jnp.array([*interior, *[1.0] * (length - len(interior)), number])


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.3), (-2.0, 1.2, 3.0)])
@pytest.mark.parametrize("matrix", [from_alpha_omega_kappa, from_omega_phi_kappa])
def test_image_equation_is_the_matrix_equation(matrix, angles):
    rotation = matrix(*angles)
    R = np.array(rotation, float).reshape(3, 3)
    p = R.T @ (np.array(POINT) - np.array(CENTRE))
    np.testing.assert_allclose(jnp.stack(photo_vector(rotation, CENTRE, POINT)), p, rtol=1e-13)
    x, y = collinearity(rotation, CENTRE, POINT, 153.2)
    np.testing.assert_allclose(jnp.stack([x, y]), -153.2 * p[:2] / p[2], rtol=1e-13)


def test_a_vertical_photograph_shows_east_right_and_north_up():
    identity = from_omega_phi_kappa(0.0, 0.0, 0.0)
    x, y = collinearity(identity, (0.0, 0.0, 1000.0), (100.0, 200.0, 0.0), 150.0)
    assert (float(x), float(y)) == pytest.approx((15.0, 30.0), rel=1e-15)


def test_object_centre_and_image_point_lie_on_one_line():
    x, y = collinearity(ROTATION, CENTRE, POINT, 80.0)
    ray = np.array(ROTATION, float).reshape(3, 3) @ [float(x), float(y), -80.0]
    np.testing.assert_allclose(np.cross(ray, np.array(POINT) - np.array(CENTRE)), 0.0, atol=1e-9)


def test_arrays_go_through_element_by_element():
    points = jnp.asarray(np.random.default_rng(3).uniform(-100.0, 100.0, (3, 2, 5)))
    x, y = jax.jit(collinearity)(ROTATION, CENTRE, tuple(points), 80.0)
    one = collinearity(ROTATION, CENTRE, tuple(points[:, 1, 3]), 80.0)
    np.testing.assert_allclose([x[1, 3], y[1, 3]], jnp.stack(one), rtol=1e-14)


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_camera_models_are_those_of_the_format(name):
    v = residual(CAMERA_MODELS[name])(INTERIORS[name], PHOTO_VECTOR, MEASURED[name])
    expected = numpy_residual(name, INTERIORS[name], PHOTO_VECTOR, MEASURED[name])
    np.testing.assert_allclose(v, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_a_residual_is_computed_minus_observed(name):
    """A measurement further to the right lowers v_x by as much (brown: up to distortion)."""
    u, v = MEASURED[name]
    model, interior = residual(CAMERA_MODELS[name]), INTERIORS[name]
    change = model(interior, PHOTO_VECTOR, (u + 1, v)) - model(interior, PHOTO_VECTOR, (u, v))
    assert float(change[0]) == pytest.approx(-1.0, abs=0.05)


@pytest.mark.parametrize("name", CAMERA_MODELS)
@pytest.mark.parametrize("argument", [0, 1, 2])
def test_camera_models_have_derivatives(name, argument):
    arguments = [jnp.array(a) for a in (INTERIORS[name], PHOTO_VECTOR, MEASURED[name])]
    model = residual(CAMERA_MODELS[name])
    forward, reverse = (jax.jit(jacobian(model, argument))(*arguments) for jacobian in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-12)
    assert jnp.isfinite(forward).all()
    for k, value in enumerate(arguments[argument]):
        h = 1e-6 * max(abs(float(value)), 1e-6)
        ends = [[a.at[k].add(s * h) if i == argument else a for i, a in enumerate(arguments)] for s in (1, -1)]
        difference = (model(*ends[0]) - model(*ends[1])) / (2 * h)
        np.testing.assert_allclose(forward[:, k], difference, rtol=1e-4, atol=1e-5 * float(abs(forward[:, k]).max()))


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_derivatives_are_finite_on_the_axis(name):
    """r = 0: nowhere is a square root of r^2 taken."""
    measured = {"none": (0.012, -0.031), "brown": (1250.0, 840.5), "bal": (0.0, 0.0)}[name]
    arguments = [jnp.array(a) for a in (INTERIORS[name], (0.0, 0.0, -700.0), measured)]
    for jacobian in jax.jit(jax.jacrev(residual(CAMERA_MODELS[name]), (0, 1, 2)))(*arguments):
        assert jnp.isfinite(jacobian).all()


def test_estimable_elements_leave_the_sensor_out():
    assert DISTORTION_FREE.estimable == ("principal_distance", "x0", "y0")
    assert BROWN.estimable[-2:] == ("b1", "b2")
    assert BAL.estimable == BAL.elements
    assert all(len(INTERIORS[name]) == len(model.elements) for name, model in CAMERA_MODELS.items())


def test_a_mixture_of_one_kind_is_that_kind():
    assert mixture((BROWN, BROWN)) is BROWN


@pytest.mark.parametrize("number, name", list(enumerate(CAMERA_MODELS)))
def test_a_mixture_computes_with_the_right_model(number, name):
    model = mixture((*CAMERA_MODELS.values(), BROWN))
    interior, vector, measured = padded(name, number), jnp.array(PHOTO_VECTOR), jnp.array(MEASURED[name])
    assert len(model.elements) == len(interior)
    own = INTERIORS[name]
    np.testing.assert_allclose(
        residual(model)(interior, vector, measured),
        residual(CAMERA_MODELS[name])(own, PHOTO_VECTOR, MEASURED[name]),
        rtol=1e-13,
    )
    jacobian = jax.jit(jax.jacrev(residual(model)))(interior, vector, measured)
    expected = jax.jit(jax.jacrev(residual(CAMERA_MODELS[name])))(jnp.array(own), vector, measured)
    np.testing.assert_allclose(jacobian[:, : len(own)], expected, rtol=1e-13)
    np.testing.assert_array_equal(jacobian[:, len(own) :], 0.0)


def test_central_projection_is_undisturbed_by_the_length_of_the_vector():
    px, py, pz = PHOTO_VECTOR
    longer, shorter = central_projection((7 * px, 7 * py, 7 * pz), 60.0), central_projection(PHOTO_VECTOR, 60.0)
    np.testing.assert_allclose(jnp.stack(longer), jnp.stack(shorter), rtol=1e-14)
