"""Derivatives through the adjustment: implicit = central differences, transposed = forward."""

import dataclasses
from collections.abc import Callable
from typing import Any

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
START = jnp.zeros(len(LEAVES))
ALL = jnp.cos(jnp.arange(len(LEAVES), dtype=float))  # a direction in which all leaves vary
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
    return jnp.sum(x * jnp.cos(1.0 + jnp.arange(x.size, dtype=float)).reshape(x.shape))


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


def adjusted(t: Float[Array, " leaf"], precision: bool = True, derivatives: Derivatives = "exact") -> dict[str, Array]:
    return numbers(jb.adjust(varied(t), stop=SHARP, precision=precision, derivatives=derivatives))


def along_all(function: Callable[[Array], Any]) -> Any:
    """Its derivative at the block in one direction."""
    return jax.tree.map(np.asarray, jax.jvp(function, (START,), (ALL,))[1])


@pytest.fixture(scope="module")
def differences() -> dict[str, np.ndarray]:
    """Central differences of fourth order."""
    columns = []
    for unit in np.eye(len(LEAVES)):
        one, two = ({s: adjusted(jnp.asarray(s * h * unit)) for s in (-1, 1)} for h in (1.0, 2.0))
        columns.append({k: (8 * (one[1][k] - one[-1][k]) - (two[1][k] - two[-1][k])) / 12 for k in one[1]})
    return {k: np.array([float(column[k]) for column in columns]) for k in columns[0]}


@pytest.fixture(scope="module")
def linear() -> Callable[[Array], dict[str, Array]]:
    """All numbers as a linear function of the steps, as every derivative of first order makes it."""
    derivative = jax.linearize(adjusted, START)[1]

    def along(step: Array) -> dict[str, Array]:  # a function with a name: jit prints one without, all its equations
        return derivative(step)

    return along


@pytest.fixture(scope="module")
def forward(linear) -> dict[str, np.ndarray]:
    along = jax.jit(linear)
    columns = [along(unit) for unit in jnp.eye(len(LEAVES))]
    return {name: np.array([float(column[name]) for column in columns]) for name in columns[0]}


def test_exact_derivatives_are_those_of_differences(differences, forward):
    for name, expected in differences.items():
        np.testing.assert_allclose(forward[name], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max(), err_msg=name)


@pytest.mark.thorough
def test_reverse_mode_gives_the_same(linear, forward):
    transposed = jax.jit(jax.linear_transpose(linear, START))
    for unit, (name, expected) in zip(jnp.eye(len(forward)), forward.items(), strict=True):
        (backward,) = transposed(dict(zip(forward, unit, strict=True)))
        atol = 1e-10 * np.abs(expected).max()
        np.testing.assert_allclose(backward, expected, rtol=1e-10, atol=atol, err_msg=name)


@pytest.mark.thorough
def test_precision_of_large_blocks_by_the_engine(forward, monkeypatch):
    """Forward through the elimination and transposed by hand, as where the whole of Q would be too large.

    Several directions at once, as in jacfwd and jacrev.
    """
    monkeypatch.setattr(implicit_precision, "MAX_UNKNOWNS", 0)
    _, linear = jax.linearize(adjusted, START)
    size = {name: np.abs(expected).max() for name, expected in forward.items()}
    directions = np.stack([ALL, 1.0 - ALL])
    along = jax.jit(jax.vmap(linear))(jnp.asarray(directions))
    for name, column in forward.items():
        np.testing.assert_allclose(along[name], directions @ column, rtol=1e-9, atol=1e-9 * size[name], err_msg=name)
    factors = {name: np.cos(1.0 + k + np.arange(2.0)) / size[name] for k, name in enumerate(forward)}
    (backward,) = jax.jit(jax.vmap(jax.linear_transpose(linear, START)))(jax.tree.map(jnp.asarray, factors))
    expected = sum(np.outer(factors[name], forward[name]) for name in forward)
    np.testing.assert_allclose(backward, expected, rtol=1e-9, atol=1e-9)


def test_exact_derivatives_beat_gauss_newton(differences, forward):
    """With residuals of three sigmas the second derivatives count."""
    without = along_all(lambda t: adjusted(t, precision=False, derivatives="gauss-newton"))
    exact, gauss_newton = (
        max(np.abs(found[k] - differences[k] @ ALL).max() / np.abs(differences[k]).max() for k in ("points", "angles"))
        for found in ({k: forward[k] @ ALL for k in forward}, without)
    )
    assert exact < 1e-7 and gauss_newton > 1e-4


def test_no_derivative_without_a_minimum():
    """Stopped on its way, an adjustment is no function of what was given: no number is a derivative."""

    def heights(t: Float[Array, " leaf"]) -> Array:
        block = varied(t)
        far = eqx.tree_at(lambda b: b.object_points, block, block.object_points + 20.0)
        stopped = jb.adjust(far, max_iterations=1, stop=SHARP, precision=False, derivatives="gauss-newton")
        return stopped.block.object_points[:, 2]

    assert np.isnan(along_all(heights)).all()


def test_under_jit_and_second_derivatives(forward):
    """Of the coordinates by two of the given, against differences of the first ones; one program for all points."""
    chosen = np.array([0, 3])

    def heights(t: Float[Array, "2"]) -> Array:
        return adjusted(START.at[chosen].set(t), False)["points"]

    unit = jnp.array([0.0, 1.0])
    both = jax.jit(lambda t: jax.jvp(jax.grad(heights), (t,), (unit,)))
    gradient, second = both(jnp.zeros(2))
    np.testing.assert_allclose(gradient, forward["points"][chosen], rtol=1e-8)
    one, two = (both(step * unit)[0] - both(-step * unit)[0] for step in (0.5, 1.0))
    np.testing.assert_allclose(second, (8 * one - two) / 6, rtol=1e-5)


def test_what_has_no_derivatives_says_so(unchecked_types):
    def robust(shift: float) -> Array:
        moved = eqx.tree_at(lambda b: b.rays.coordinates, BLOCK, BLOCK.rays.coordinates + shift)
        return jb.adjust(moved, robust=jb.robust.Huber()).sigma0

    with pytest.raises(ValueError, match="robust estimation does not work inside"):
        jax.grad(robust)(0.0)
    with pytest.raises(ValueError, match="no derivatives 'by hand'; there are"):
        jb.adjust(BLOCK, derivatives="by hand")  # pyright: ignore[reportArgumentType]


def bare(factor: float) -> jb.Block:
    """Rays alone, with larger sigmas."""
    structure = dataclasses.replace(BLOCK.structure, datum=jb.blocks.Datum("open"))
    block = dataclasses.replace(BLOCK, structure=structure, groups=())
    return eqx.tree_at(lambda b: b.rays.sigmas, block, factor * block.rays.sigmas)


def test_the_datum_is_chosen_under_grad_but_not_under_jit():
    """Under grad alone the values are known: a phase after the choice is reached."""

    class Chosen(Exception):
        pass

    def planned(phase: str) -> None:
        if phase == "planning":
            raise Chosen

    def sigma0(factor: float) -> Array:
        return jb.adjust(bare(factor), precision=False, phase=planned).sigma0

    with pytest.raises(Chosen):
        jax.grad(sigma0)(1.0)
    with pytest.raises(ValueError, match="the datum is chosen before tracing"):
        jax.jit(jax.grad(sigma0))(1.0)


@pytest.mark.thorough
def test_derivatives_with_the_datum_that_is_chosen():
    def sigma0(factor: float) -> Array:
        return jb.adjust(bare(factor), precision=False).sigma0

    np.testing.assert_allclose(jax.grad(sigma0)(1.0), -sigma0(1.0), rtol=1e-9)


def test_a_free_network_says_why_it_has_none():
    structure = dataclasses.replace(BLOCK.structure, datum=jb.blocks.Datum("inner"))
    free = dataclasses.replace(BLOCK, structure=structure, groups=())

    def height(factor: float) -> Array:
        return jb.adjust(eqx.tree_at(lambda b: b.rays.sigmas, free, factor * free.rays.sigmas)).sigma0

    with pytest.raises(ValueError, match="a free network cannot be adjusted inside jit, grad and vmap"):
        jax.grad(height)(1.0)
