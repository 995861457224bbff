"""Rotations: every way from a matrix and back, on purpose at and near the attitudes where angles or signs are lost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm, expm_frechet
from scipy.spatial.transform import Rotation as ScipyRotation

from jaxbundle.geometry import rotation as rot
from jaxbundle.numerics.compilation import QUICKLY

SYSTEMS = list(rot.ROTATION_SYSTEMS.values())
OFFSETS = (0.0, 1e-12, 1e-9, 1e-7, 1e-4)
ATTITUDES = [(0.3, -0.2, 1.1), (-2.9, 1.2, 3.1), (3.0, -1.5, -2.0), (0.0, 0.0, np.pi / 2), (np.pi, 0.0, 0.0)]
DIRECTIONS = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, -1), (1, 1, 1), (-3, 2, 1), (1e-9, 1, -1e-9)]
AXES = np.array(DIRECTIONS) / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)

angle = st.floats(-np.pi, np.pi)
hundred_examples = settings(max_examples=100)


def matrix(rotation):
    """One 3 x 3 matrix, or one a rotation."""
    stacked = np.stack(np.broadcast_arrays(*rotation), axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)


def elements(matrix):
    return tuple(jnp.asarray(matrix[..., i, j]) for i in range(3) for j in range(3))


def skew(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@jax.jit
@jax.jacobian
def jacobian_of_the_matrix(vector):
    return jnp.stack(rot.from_rotation_vector(*vector))


@jax.jit
@jax.vmap
@jax.jacobian
def jacobian_there_and_back(vector):
    return jnp.stack(rot.to_rotation_vector(rot.from_rotation_vector(*vector)))


def elementary(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


@pytest.mark.parametrize("angles", ATTITUDES)
def test_matrices_are_the_products_of_elementary_rotations(angles):
    alpha, omega, kappa = angles
    textbook = elementary("y", -alpha) @ elementary("x", omega) @ elementary("z", kappa)
    usual = elementary("x", alpha) @ elementary("y", omega) @ elementary("z", kappa)
    np.testing.assert_allclose(matrix(rot.from_alpha_omega_kappa(*angles)), textbook, atol=1e-15)
    np.testing.assert_allclose(matrix(rot.from_omega_phi_kappa(*angles)), usual, atol=1e-15)


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_zero_angles_are_the_identity(system):
    np.testing.assert_array_equal(matrix(system.rotation_from_angles(0.0, 0.0, 0.0)), np.eye(3))
    np.testing.assert_array_equal(jnp.stack(system.angles_from_rotation(elements(np.eye(3)))), np.zeros(3))
    np.testing.assert_array_equal(matrix(rot.IDENTITY), np.eye(3))


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
@given(first=angle, middle=angle, last=angle)
@hundred_examples
def test_angles_reproduce_the_matrix(system, first, middle, last):
    rotation = system.rotation_from_angles(first, middle, last)
    angles = system.angles_from_rotation(rotation)
    assert abs(float(angles[1])) <= np.pi / 2 + 1e-15
    np.testing.assert_allclose(matrix(system.rotation_from_angles(*angles)), matrix(rotation), atol=2e-15)
    np.testing.assert_allclose(matrix(rotation).T @ matrix(rotation), np.eye(3), atol=1e-15)


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
@pytest.mark.parametrize("angles", [(0.7, -1.2, 2.9), (-3.0, 1.5, -0.4)])
def test_angles_in_range_come_back(system, angles):
    np.testing.assert_allclose(
        jnp.stack(system.angles_from_rotation(system.rotation_from_angles(*angles))), angles, rtol=1e-14
    )


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("offset", OFFSETS)
def test_singular_attitude_is_reproduced(system, sign, offset):
    rng = np.random.default_rng(1)
    first, last = (jnp.asarray(a) for a in rng.uniform(-np.pi, np.pi, (2, 200)))
    middle = jnp.full(200, sign * (np.pi / 2 - offset))
    rotation = system.rotation_from_angles(first, middle, last)
    angles = system.angles_from_rotation(rotation)
    np.testing.assert_allclose(angles[1], middle, atol=1e-15)
    np.testing.assert_allclose(matrix(system.rotation_from_angles(*angles)), matrix(rotation), atol=2e-15)


@pytest.mark.parametrize("angles", ATTITUDES)
def test_both_systems_describe_one_rotation(angles):
    usual = rot.to_omega_phi_kappa(rot.from_alpha_omega_kappa(*angles))
    back = rot.to_alpha_omega_kappa(rot.from_omega_phi_kappa(*usual))
    np.testing.assert_allclose(
        matrix(rot.from_alpha_omega_kappa(*back)), matrix(rot.from_alpha_omega_kappa(*angles)), atol=2e-15
    )


def test_product_transpose_and_apply_are_those_of_matrices():
    left, right = rot.from_alpha_omega_kappa(0.1, -0.2, 0.3), rot.from_omega_phi_kappa(1.1, 0.4, -2.0)
    vector = (1.5, -2.0, 0.3)
    np.testing.assert_allclose(matrix(rot.product(left, right)), matrix(left) @ matrix(right), atol=1e-15)
    np.testing.assert_array_equal(matrix(rot.transpose(left)), matrix(left).T)
    np.testing.assert_allclose(jnp.stack(rot.apply(left, vector)), matrix(left) @ vector, atol=1e-15)


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_arrays_go_through_element_by_element(system):
    angles = jnp.asarray(np.random.default_rng(2).uniform(-1.5, 1.5, (3, 2, 4)))
    whole = jax.jit(system.angles_from_rotation)(system.rotation_from_angles(*angles))
    np.testing.assert_allclose(jnp.stack(whole), angles, atol=1e-14)
    one = system.angles_from_rotation(system.rotation_from_angles(*angles[:, 1, 2]))
    np.testing.assert_allclose(jnp.stack(whole)[:, 1, 2], jnp.stack(one), atol=1e-15)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-9, 1e-6, 0.5, np.pi / 2, 2 * np.pi / 3, np.pi - 1e-9, np.pi])
def test_quaternion_at_every_turn(turn):
    expected = ScipyRotation.from_rotvec(turn * AXES).as_matrix()
    quaternion = jnp.stack(rot.to_quaternion(elements(expected)))
    assert (quaternion[0] >= 0).all()
    np.testing.assert_allclose(jnp.linalg.norm(quaternion, axis=0), 1.0, atol=1e-15)
    np.testing.assert_allclose(matrix(rot.from_quaternion(*quaternion)), expected, atol=2e-15)


def test_quaternion_need_not_be_of_unit_length():
    q = np.array([0.3, -1.2, 2.0, 0.7])
    expected = ScipyRotation.from_quat(q, scalar_first=True).as_matrix()
    np.testing.assert_allclose(matrix(rot.from_quaternion(*q)), expected, atol=1e-15)


@given(q=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3))
@hundred_examples
def test_quaternion_round_trip(q):
    rotation = rot.from_quaternion(*q)
    back = rot.from_quaternion(*rot.to_quaternion(rotation))
    np.testing.assert_allclose(matrix(back), matrix(rotation), atol=3e-15)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-8, 9e-5, 1.1e-4, 1e-2, 1.0, np.pi / 2, 3.0, np.pi - 1e-9, np.pi])
def test_rotation_vector_at_every_turn(turn):
    vectors = turn * AXES
    rotation = rot.from_rotation_vector(*jnp.asarray(vectors.T))
    np.testing.assert_allclose(matrix(rotation), [expm(skew(vector)) for vector in vectors], atol=2e-15)
    np.testing.assert_allclose(matrix(rot.product(rot.transpose(rotation), rotation)) - np.eye(3), 0.0, atol=1e-15)
    back = jnp.stack(rot.to_rotation_vector(rotation))
    assert (jnp.linalg.norm(back, axis=0) <= np.pi + 1e-15).all()
    np.testing.assert_allclose(matrix(rot.from_rotation_vector(*back)), matrix(rotation), atol=2e-15)
    if turn < np.pi:  # at half a turn both ends of the axis are right
        np.testing.assert_allclose(back.T, vectors, atol=2e-15, rtol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 9.9e-5, 1.01e-4, 0.3, np.pi / 2, 3.1])
def test_derivative_of_the_rotation_vector_is_that_of_the_exponential(turn):
    vector = turn * AXES[-2]
    jacobian = jacobian_of_the_matrix(jnp.asarray(vector))
    for k in range(3):
        expected = expm_frechet(skew(vector), skew(np.eye(3)[k]), compute_expm=False)
        np.testing.assert_allclose(np.asarray(jacobian)[:, k].reshape(3, 3), expected, atol=2e-15)


def test_second_derivative_of_the_rotation_vector_at_zero():
    hessian = np.asarray(jax.jit(jax.hessian(lambda v: jnp.stack(rot.from_rotation_vector(*v))))(jnp.zeros(3)))
    for i, j in np.ndindex(3, 3):
        si, sj = skew(np.eye(3)[i]), skew(np.eye(3)[j])
        np.testing.assert_allclose(hessian[:, i, j].reshape(3, 3), (si @ sj + sj @ si) / 2, atol=1e-15)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, np.pi / 2, 2 * np.pi / 3, np.pi - 1e-7])
def test_derivative_back_to_the_rotation_vector(turn):
    jacobians = jacobian_there_and_back(jnp.asarray(turn * AXES))
    np.testing.assert_allclose(jacobians, np.broadcast_to(np.eye(3), (8, 3, 3)), atol=1e-8)


@pytest.mark.parametrize("rows", [((0, -1, 0), (1, 0, 0), (0, 0, 1)), ((0, 0, 1), (1, 0, 0), (0, 1, 0))])
def test_derivative_of_the_quaternion_where_its_elements_tie(rows):
    """A quarter turn has two elements equally large, 120 deg about (1, 1, 1) all four; d q = q (0, v / 2)."""
    rotation = elements(np.array(rows, float))
    q0, qx, qy, qz = rot.to_quaternion(rotation)
    expected = np.array([[-qx, -qy, -qz], [q0, -qz, qy], [qz, q0, -qx], [-qy, qx, q0]]) / 2

    def turned(vector):
        return jnp.stack(rot.to_quaternion(rot.product(rotation, rot.from_rotation_vector(*vector))))

    np.testing.assert_allclose(jax.jacobian(turned)(jnp.zeros(3)), expected, atol=1e-15)


def test_derivative_at_half_a_turn_is_finite():
    rotations = jnp.asarray([(2 * np.outer(axis, axis) - np.eye(3)).ravel() for axis in AXES])
    jacobian = jax.jit(jax.vmap(jax.jacobian(lambda r: jnp.stack(rot.to_rotation_vector(tuple(r))))))
    assert jnp.isfinite(jacobian(rotations)).all()


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_matrices_from_angles_are_analytic(system):
    """A complex step gives the automatic derivative: the ground of the cross-check of the partials."""
    angles = jnp.array([0.4, -1.3, 2.2])
    jacobian = jax.jit(jax.jacobian(lambda a: jnp.stack(system.rotation_from_angles(*a))))(angles)
    stepped = jnp.stack(
        system.rotation_from_angles(*(angles[:, None].astype(complex) + 1e-30j * jnp.eye(3, dtype=complex)))
    )
    np.testing.assert_allclose(stepped.imag / 1e-30, jacobian, atol=1e-15)


def test_quaternions_where_elements_tie_are_the_same_compiled():
    """A compiler that compared the same two numbers twice, rounded differently, mixed rows of opposite sign."""
    turns = jnp.asarray(np.concatenate([turn * AXES for turn in (np.pi / 2, 2 * np.pi / 3, np.pi)]))

    def there_and_back(vector):
        rotation = rot.from_rotation_vector(*vector)
        return jnp.stack(rotation), jnp.stack(rot.from_quaternion(*rot.to_quaternion(rotation)))

    for options in ({}, QUICKLY):
        given, again = jax.jit(jax.vmap(there_and_back), compiler_options=options)(turns)
        np.testing.assert_allclose(again, given, atol=1e-14)
