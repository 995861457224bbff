"""Values kept in memory are what they were; linear functions with a transposed function of their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.numerics.linear_map import linear_map
from jaxbundle.numerics.stored import stored

X = jnp.array([0.3, -1.2, 2.0])


def of_stored(x: jax.Array, zero: jax.Array) -> jax.Array:
    first, second = stored((jnp.sin(x), x * x), zero)
    return stored(first * second, zero).sum()


def plain(x: jax.Array) -> jax.Array:
    return (jnp.sin(x) * x * x).sum()


def test_stored_values_and_their_derivatives():
    zero = jnp.zeros((), int)
    for transformed in (lambda f: f, jax.grad, jax.hessian, lambda f: jax.jacfwd(jax.grad(f))):
        np.testing.assert_allclose(transformed(lambda x: of_stored(x, zero))(X), transformed(plain)(X), rtol=1e-15)
    batch = jnp.stack([X, 2 * X])
    found = jax.jit(jax.vmap(jax.grad(of_stored), (0, None)))(batch, zero)
    np.testing.assert_allclose(found, jax.vmap(jax.grad(plain))(batch), rtol=1e-15)


def test_stored_values_of_which_some_have_no_derivative():
    def first_of(x: jax.Array) -> jax.Array:
        one, _, two = stored((jnp.sin(x[0]), jnp.cos(x[1]), jnp.ones(())), jnp.zeros((), int))
        return one * two

    for derivative in (jax.grad, jax.jacfwd, jax.hessian):
        expected = derivative(lambda x: jnp.sin(x[0]))(X)
        np.testing.assert_allclose(jax.jit(derivative(first_of))(X), expected, rtol=1e-15)


def mapped(matrix: jax.Array, x: jax.Array) -> jax.Array:
    """The matrix times x. A loop of unknown length has no transposed function that JAX would find."""

    def forward(v: jax.Array) -> jax.Array:
        turns = 1 + jnp.sum(jnp.isnan(matrix))
        return jax.lax.fori_loop(0, turns, lambda _, y: y + matrix @ v, jnp.zeros(2))

    return linear_map(forward, lambda c: matrix.T @ c, x, 2, matrix, "no derivative by the matrix")


def test_a_linear_map_is_differentiated_both_ways():
    matrix = jnp.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 4.0]])
    np.testing.assert_array_equal(mapped(matrix, X), matrix @ X)
    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(jacobian(lambda x: mapped(matrix, x))(X), matrix)
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(jnp.sin(mapped(matrix, x)))))(X)
    np.testing.assert_allclose(gradient, matrix.T @ jnp.cos(matrix @ X), rtol=1e-15)


def test_what_it_is_made_of_has_no_derivative():
    matrix = jnp.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 4.0]])
    for derivative in (jax.grad, jax.jacfwd, jax.jacrev):
        for of in (derivative(lambda m: mapped(m, X).sum()), jax.jit(derivative(lambda m: mapped(m, X).sum()))):
            with pytest.raises(ValueError, match="no derivative by the matrix"):
                of(matrix)


def test_a_linear_map_along_a_tangent_is_differentiated_once():
    """As where the derivative of one function is written by another: first derivatives do not ask for those of L."""

    @jax.custom_jvp
    def square(x: jax.Array) -> jax.Array:
        return jnp.array([1.0, 2.0]) * (x @ x)

    @square.defjvp
    def _(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
        (x,), (t,) = primals, tangents
        rows = jnp.outer(jnp.array([2.0, 4.0]), x)
        return square(x), linear_map(lambda v: rows @ v, lambda c: rows.T @ c, t, 2, rows, "once only")

    expected = np.outer([2.0, 4.0], X)
    for jacobian in (jax.jacfwd, jax.jacrev, lambda f: jax.jit(jax.jacrev(f))):
        np.testing.assert_allclose(jacobian(square)(X), expected, rtol=1e-15)
    for second in (jax.hessian(square), jax.jacrev(jax.jacrev(square)), jax.jit(jax.jacfwd(jax.jacfwd(square)))):
        with pytest.raises(ValueError, match="once only"):
            second(X)
