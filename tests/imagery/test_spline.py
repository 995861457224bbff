"""Grey values between pixels, with their slopes."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbundle.imagery import spline

SIZE = 9
X, Y = (a.ravel() for a in np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5))
BETWEEN = np.random.default_rng(0).uniform(2.0, SIZE - 2.0, (2, 50))
STEP = 1e-6


def test_the_spline_passes_through_the_pixels():
    """Near the border a polynomial is continued."""
    grey = np.random.default_rng(1).uniform(0, 255, (SIZE, SIZE))
    found = spline.value(spline.coefficients(jnp.asarray(grey)), jnp.asarray(X), jnp.asarray(Y))
    inside = np.reshape(found, (SIZE, SIZE))[1:-1, 1:-1]
    np.testing.assert_allclose(inside, grey[1:-1, 1:-1], atol=1e-10)


def test_slopes_of_the_spline_are_those_of_differences():
    coefficients = jnp.asarray(np.random.default_rng(2).uniform(0, 255, (SIZE, SIZE)))
    x, y = (jnp.asarray(a) for a in BETWEEN)
    found = jax.vmap(jax.grad(lambda x, y: spline.value(coefficients, x, y), (0, 1)))(x, y)
    ahead, behind = (
        (spline.value(coefficients, x + d, y), spline.value(coefficients, x, y + d)) for d in (STEP, -STEP)
    )
    np.testing.assert_allclose(found, (np.array(ahead) - np.array(behind)) / (2 * STEP), rtol=1e-6, atol=1e-5)


def test_bilinear_greys_are_exact_with_their_slopes():
    """Of a window a + b x + c y + d x y."""

    def grey(x, y):
        return 3 + 2 * x - 0.5 * y + 0.25 * x * y

    window, (x, y) = jnp.asarray(grey(X, Y).reshape(SIZE, SIZE)), (jnp.asarray(a) for a in BETWEEN)
    np.testing.assert_allclose(spline.bilinear(window, x, y), grey(x, y), rtol=1e-12)
    slopes = jax.vmap(jax.grad(lambda x, y: spline.bilinear(window, x, y), (0, 1)))(x, y)
    np.testing.assert_allclose(slopes, (2 + 0.25 * y, -0.5 + 0.25 * x), rtol=1e-12)
