"""Derivatives through the adjustment: implicit = central differences, transposed = forward."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.weak_geometry import SIGMA, bent_block
from jaxtyping import Array, Float

import jaxbundle as jb
from jaxbundle.solve import implicit_precision
from jaxbundle.solve.implicit import Derivatives

SHARP = jb.stopping.AngleRule(1e-13)  # differences need the digits
LEAVES = {  # what is varied, and by how much at once
    "measured": (lambda b: b.rays.coordinates, 0.1 * SIGMA),
    "ray sigmas": (lambda b: b.rays.sigmas, 0.005 * SIGMA),
    "control": (lambda b: b.groups[0].values, 0.005),
    "control sigmas": (lambda b: b.groups[0].sigmas, 0.001),
    "held interior": (lambda b: b.interior.elements[:, 1:], np.array([2e-3, 2e-3, 2e-4])),  # and the camera's own
    "distance": (lambda b: b.groups[1].values, 0.01),
    "distance sigma": (lambda b: b.groups[1].sigmas, 0.001),
    "constant": (lambda b: b.groups[2].constants, 1e-5),
}
RNG = np.random.default_rng(5)
BLOCK = jb.blocks.with_datum(bent_block(noise=3.0))
DIRECTIONS = {name: jnp.asarray(step * RNG.standard_normal(get(BLOCK).shape)) for name, (get, step) in LEAVES.items()}


@jax.jit
def varied(t: Float[Array, " leaf"]) -> jb.Block:
    """The block after t steps along every direction."""
    block = BLOCK
    for k, (name, (get, _)) in enumerate(LEAVES.items()):
        if name == "held interior":
            moved = block.interior.elements.at[:, 1:].add(t[k] * DIRECTIONS[name])
            block = eqx.tree_at(lambda b: b.interior.elements, block, moved)
        else:
            block = eqx.tree_at(get, block, get(block) + t[k] * DIRECTIONS[name])
    return block


def mixed(x: Array) -> Array:
    """A sum of all numbers with different weights."""
    return jnp.sum(x * jnp.cos(1.0 + jnp.arange(x.size)).reshape(x.shape))


@jax.jit
def numbers(result: jb.Adjustment) -> dict[str, Array]:
    """Something of everything in an adjustment."""
    block = result.block
    found = {
        "points": mixed(block.object_points),
        "centres": mixed(block.exterior.projection_centre),
        "angles": mixed(block.exterior.angles),
        "interior": block.interior.elements[0, 0],
        "sigma0": result.sigma0,
        "residuals": sum(map(mixed, result.residuals)),
    }
    r = result.redundancy_numbers
    if result.cofactors is None or r is None:
        return found
    sd = result.standard_deviations
    controlled = r[0] > 0.1  # in the direction of the base nothing controls a point of two images
    return found | {
        "sd of points": mixed(sd.object_points),
        "sd of angles": mixed(sd.angles),
        "sd of interior": mixed(sd.interior),
        "correlations of cofactors": mixed(result.cofactors.object_points),
        "redundancy numbers": sum(map(mixed, r)),
        "w": mixed(
            jnp.where(controlled, result.weighted_residuals[0] / jnp.sqrt(jnp.where(controlled, r[0], 1.0)), 0.0)
        ),
    }


def adjusted(
    t: Float[Array, " leaf"], precision: bool = True, derivatives: Derivatives = "exact", devices: int = 1
) -> dict[str, Array]:
    block = varied(t)
    return numbers(jb.adjust(block, stop=SHARP, precision=precision, derivatives=derivatives, devices=devices))


@pytest.fixture(scope="module")
def differences() -> dict[str, np.ndarray]:
    """Central differences of fourth order."""
    columns = []
    for unit in np.eye(len(LEAVES)):
        one, two = ({s: adjusted(jnp.asarray(s * h * unit)) for s in (-1, 1)} for h in (1.0, 2.0))
        columns.append({k: (8 * (one[1][k] - one[-1][k]) - (two[1][k] - two[-1][k])) / 12 for k in one[1]})
    return {k: np.array([float(column[k]) for column in columns]) for k in columns[0]}


@pytest.fixture(scope="module")
def forward() -> dict[str, np.ndarray]:
    return jax.tree.map(np.asarray, jax.jacfwd(adjusted)(jnp.zeros(len(LEAVES))))


def test_exact_derivatives_are_those_of_differences(differences, forward):
    for name, expected in differences.items():
        np.testing.assert_allclose(forward[name], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max(), err_msg=name)


def test_reverse_mode_gives_the_same(forward):
    backward = jax.jacrev(adjusted)(jnp.zeros(len(LEAVES)))
    for name, expected in forward.items():
        atol = 1e-10 * np.abs(expected).max()
        np.testing.assert_allclose(backward[name], expected, rtol=1e-10, atol=atol, err_msg=name)


@pytest.mark.parametrize("devices", [pytest.param(1, marks=pytest.mark.thorough), 2])
def test_precision_of_large_blocks_by_the_engine(forward, monkeypatch, devices):
    """Forward through the elimination and transposed by hand, as where the whole of Q would be too large."""
    monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", 0)
    of = partial(adjusted, devices=devices)
    backward = jax.jacrev(of)(jnp.zeros(len(LEAVES)))
    direction = jnp.cos(jnp.arange(len(LEAVES)))
    _, along = jax.jvp(of, (jnp.zeros(len(LEAVES)),), (direction,)) if devices == 1 else (None, {})
    for name, expected in forward.items():
        atol = 1e-9 * np.abs(expected).max()
        np.testing.assert_allclose(backward[name], expected, rtol=1e-9, atol=atol, err_msg=name)
        np.testing.assert_allclose(along.get(name, expected @ direction), expected @ direction, rtol=1e-9, atol=atol)


def test_exact_derivatives_beat_gauss_newton(differences, forward):
    """With residuals of three sigmas the second derivatives count."""
    without = jax.jacrev(partial(adjusted, precision=False, derivatives="gauss-newton"))(jnp.zeros(len(LEAVES)))
    exact, gauss_newton = (
        max(np.abs(found[k] - differences[k]).max() / np.abs(differences[k]).max() for k in ("points", "angles"))
        for found in (forward, without)
    )
    assert exact < 1e-7 and gauss_newton > 1e-4


def test_second_derivatives():
    """Of the coordinates by two of the given, against differences of the first ones."""

    def heights(t: Float[Array, "2"]) -> Array:
        return adjusted(jnp.zeros(len(LEAVES)).at[np.array([0, 3])].set(t), False)["points"]

    gradient, unit = jax.grad(heights), jnp.array([0.0, 1.0])
    one, two = (gradient(step * unit) - gradient(-step * unit) for step in (0.5, 1.0))
    _, second = jax.jvp(gradient, (jnp.zeros(2),), (unit,))
    np.testing.assert_allclose(second, (8 * one - two) / 6, rtol=1e-5)


def test_second_derivatives_of_the_precision_of_large_blocks_are_refused(monkeypatch):
    monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", 0)
    start = jnp.zeros(len(LEAVES))

    def scatter(t: Float[Array, " leaf"]) -> Array:
        return adjusted(t)["sd of points"]

    for second in (jax.jacfwd(jax.jacfwd(scatter)), jax.grad(lambda t: jax.grad(scatter)(t)[0])):
        with pytest.raises(ValueError, match=r"have no second derivatives: call adjust\(\.\.\., precision=False\)"):
            jax.eval_shape(second, start)


def test_under_jit(forward):
    compiled = jax.jit(jax.grad(lambda t: adjusted(t, False)["sigma0"]))(jnp.zeros(len(LEAVES)))
    np.testing.assert_allclose(compiled, forward["sigma0"], rtol=1e-8)


def test_no_derivative_without_a_minimum():
    """Stopped on its way, an adjustment is no function of what was given: no number is a derivative."""
    far = eqx.tree_at(lambda b: b.object_points, BLOCK, BLOCK.object_points + 20.0)

    def height(shift: float) -> Array:
        moved = eqx.tree_at(lambda b: b.groups[0].values, far, far.groups[0].values + shift)
        return jb.adjust(moved, max_iterations=1, precision=False).block.object_points[0, 2]

    assert np.isnan(jax.grad(height)(0.0))


def test_what_has_no_derivatives_says_so():
    def robust(shift: float) -> Array:
        moved = eqx.tree_at(lambda b: b.rays.coordinates, BLOCK, BLOCK.rays.coordinates + shift)
        return jb.adjust(moved, robust=jb.robust.Huber()).sigma0

    with pytest.raises(ValueError, match="robust estimation does not work inside"):
        jax.grad(robust)(0.0)
    with pytest.raises(ValueError, match="no derivatives 'by hand'; there are"):
        jb.adjust(BLOCK, derivatives="by hand")  # pyright: ignore[reportArgumentType]


def test_the_datum_is_chosen_under_grad_but_not_under_jit():
    """Under grad alone the values are known."""
    structure = dataclasses.replace(BLOCK.structure, datum=jb.blocks.Datum("open"))
    bare = dataclasses.replace(BLOCK, structure=structure, groups=())

    def sigma0(factor: float) -> Array:
        return jb.adjust(eqx.tree_at(lambda b: b.rays.sigmas, bare, factor * bare.rays.sigmas), precision=False).sigma0

    np.testing.assert_allclose(jax.grad(sigma0)(1.0), -sigma0(1.0), rtol=1e-9)
    with pytest.raises(ValueError, match="the datum is chosen before tracing"):
        jax.jit(jax.grad(sigma0))(1.0)


def test_a_free_network_says_why_it_has_none():
    structure = dataclasses.replace(BLOCK.structure, datum=jb.blocks.Datum("inner"))
    free = dataclasses.replace(BLOCK, structure=structure, groups=())

    def height(factor: float) -> Array:
        return jb.adjust(eqx.tree_at(lambda b: b.rays.sigmas, free, factor * free.rays.sigmas)).sigma0

    with pytest.raises(ValueError, match="a free network cannot be adjusted inside jit, grad and vmap"):
        jax.grad(height)(1.0)
