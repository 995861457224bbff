"""Frames of planes and lines hang on the points alone: neither their order nor equal extents change them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import observed, strip, with_parameters

from jaxbundle.block.geodetic import FRAME, LINES, PLANES
from jaxbundle.orientation.planes_and_lines import with_planes_and_lines

SQUARE = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])  # two equal extents
TURNS = {
    "level": np.eye(3),
    "wall": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "other wall": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "roof": np.linalg.qr(np.array([[1.0, 0.3, 0.7], [0.2, 1, -0.7], [0.1, 0.5, 1]]))[0],
}


@pytest.fixture(scope="module")
def block():
    return strip()


def frame(block, kind, points, order) -> np.ndarray:
    """Third axis last: origin and axes of one figure through some points, its rows in some order."""
    names = ("a", "b", "d") if kind is PLANES else ("a", "b", "p", "q")
    block, n = with_parameters(block, dict.fromkeys(names, 0.0))
    block = eqx.tree_at(lambda b: b.object_points, block, block.object_points.at[: len(points)].set(points))
    constants = np.tile([0, 0, 0, *np.eye(3).ravel()], (len(points), 1)).astype(float)
    block = observed(block, kind, [[p, *n] for p in order], 0.02, constants)
    unknown = jnp.full((len(points), len(FRAME)), jnp.nan)
    found, problems = with_planes_and_lines(eqx.tree_at(lambda b: b.groups[-1].constants, block, unknown))
    assert not problems
    return np.asarray(found.groups[-1].constants)[0]


@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize("kind", [PLANES, LINES], ids=["plane", "line"])
def test_order_of_the_rows(block, name, kind):
    """Of a square, and of a line."""
    shape = SQUARE if kind is PLANES else np.arange(4.0)[:, None] * [0.0, 0.0, 2.0]
    points = shape @ TURNS[name].T + [10.0, 20.0, 30.0]
    first = frame(block, kind, points, np.arange(4))
    axes = first[3:].reshape(3, 3)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) > 0
    across = axes[:, 2] if kind is PLANES else axes[:, :2]
    np.testing.assert_allclose((points - first[:3]) @ across, 0, atol=1e-13)
    rng = np.random.default_rng(0)
    for _ in range(5):
        np.testing.assert_allclose(frame(block, kind, points, rng.permutation(4)), first, atol=1e-13)
    np.testing.assert_allclose(frame(block, kind, points[::-1], np.arange(4)), first, atol=1e-13)


@pytest.mark.parametrize(("turn", "third"), [("level", (0, 0, 1)), ("wall", (0, 1, 0)), ("other wall", (1, 0, 0))])
def test_sense_of_the_third_axis(block, turn, third):
    """Up; of a vertical plane to +Y, or to +X."""
    for sign in (1, -1):
        points = sign * SQUARE @ TURNS[turn].T
        np.testing.assert_allclose(frame(block, PLANES, points, np.arange(4))[5::3], third, atol=1e-14)
