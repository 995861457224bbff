"""The image equation against matrices written out in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.camera.collinearity import central_projection, collinearity, photo_vector
from jaxbundle.geometry.rotation import from_alpha_omega_kappa, from_omega_phi_kappa

CENTRE, POINT = (100.0, -50.0, 750.0), (310.0, 120.0, 12.5)
ROTATION = from_omega_phi_kappa(0.05, -0.08, 2.1)
PHOTO_VECTOR = (210.0, -170.0, -737.5)


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


def test_central_projection_is_undisturbed_by_the_length_of_the_vector():
    px, py, pz = PHOTO_VECTOR
    longer, shorter = central_projection((7 * px, 7 * py, 7 * pz), 60.0), central_projection(PHOTO_VECTOR, 60.0)
    np.testing.assert_allclose(jnp.stack(longer), jnp.stack(shorter), rtol=1e-14)
