"""Every camera model against its definition, its derivatives, and what an adjustment recovers of it."""

import dataclasses
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.camera_definitions import INTERIORS, MEASURED, PHOTO_VECTOR, computed, definition
from cases.typechecker import unchecked

from jaxbundle.block.block import Block, Camera, Structure
from jaxbundle.camera.additional_parameters import EBNER, GRUEN, orthogonal_corrections, polynomials
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.camera.forward import BAL, BROWN_FORWARD
from jaxbundle.camera.model import HELD, mixture
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import exact_coordinates, simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status


@cache
def residual(model):
    """The residual as a program of one vector: interior, photo vector, measurement."""

    @jax.jit
    def stacked(arguments):
        *interior, px, py, pz, u, v = arguments
        return jnp.stack(model.residual(tuple(interior), (px, py, pz), (u, v)))

    return stacked


def arguments(name):
    return np.array([*INTERIORS[name], *PHOTO_VECTOR, *MEASURED[name]])


def complex_step(model, values):
    """Derivatives Im F(u + i h) / h with h = 1e-30, exact to rounding (Squire & Trapp 1998)."""
    columns = []
    with unchecked():  # no function of the package says that it takes complex numbers
        for k in range(len(values)):
            *interior, px, py, pz, u, v = values + 1e-30j * (np.arange(len(values)) == k)
            columns.append(np.imag(model.residual(tuple(interior), (px, py, pz), (u, v))) / 1e-30)
    return np.array(columns).T


def assert_same_derivatives(found, expected):
    """Column by column, to rounding."""
    size = np.abs(expected).max(0)
    assert (np.abs(found - expected) <= 1e-11 * size).all(), np.abs(found - expected).max(0) / size


# One model


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_a_model_is_that_of_the_format(name):
    expected = definition(name, INTERIORS[name], PHOTO_VECTOR, MEASURED[name])
    np.testing.assert_allclose(residual(CAMERA_MODELS[name])(arguments(name)), expected, rtol=1e-12, atol=2e-11)


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_autodiff_is_the_complex_step(name):
    model, values = CAMERA_MODELS[name], arguments(name)
    assert_same_derivatives(jax.jit(jax.jacrev(residual(model)))(values), complex_step(model, values))


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_a_residual_is_computed_minus_observed(name):
    """A measurement further to the right lowers v_x by as much, one further up lowers v_y, up to distortion."""
    model, interior = CAMERA_MODELS[name], INTERIORS[name]
    up = dict(zip(model.elements, interior, strict=True)).get("y_axis", 1.0)
    u, v = MEASURED[name]
    start, right, above = (
        computed(model, interior, PHOTO_VECTOR, measured) for measured in ((u, v), (u + 1e-3, v), (u, v + up * 1e-3))
    )
    np.testing.assert_allclose(np.array([right - start, above - start]) / 1e-3, -np.eye(2), atol=0.05)


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_derivatives_are_finite_on_the_axis(name):
    """r = 0: nowhere is a square root of r^2 taken."""
    elements = dict(zip(CAMERA_MODELS[name].elements, INTERIORS[name], strict=True))
    centre = elements.get("x0", 0.0), elements.get("y0", 0.0)
    values = np.array([*INTERIORS[name], 0.0, 0.0, -700.0, *centre])
    assert jnp.isfinite(jax.jit(jax.jacrev(residual(CAMERA_MODELS[name])))(values)).all()


def test_models_have_their_elements():
    assert DISTORTION_FREE.estimable == ("principal_distance", "x0", "y0")
    assert BROWN.estimable[-2:] == ("b1", "b2") and BAL.estimable == BAL.elements
    assert EBNER.estimable[3:] == ("K1", "K2", "K3", "P1", "P2", *(f"e{k}" for k in range(1, 13)))
    assert GRUEN.estimable[8:] == tuple(f"g{k}" for k in range(1, 45))
    assert all(len(INTERIORS[name]) == len(model.elements) for name, model in CAMERA_MODELS.items())
    assert all(not set(HELD) & set(model.estimable) for model in CAMERA_MODELS.values())


# Relations


def test_brown_forward_is_the_inverse_of_brown_at_first_order():
    """Coefficients with the opposite sign; what is left falls with their square."""
    coefficients = np.array([1.3e-4, -2.1e-7, 3e-10, 2.5e-5, -1.7e-5])

    def left(size):
        d, point = size * coefficients, (12.0, -9.0, -28.4)
        on_image = computed(BROWN_FORWARD, (28.4, 0.0, 0.0, *-d, 1.0, 1.0), point, (0.0, 0.0))
        return np.abs(computed(BROWN, (28.4, 0.0, 0.0, *d, 0.0, 0.0, 1.0, 1.0), point, on_image)).max()

    assert left(1.0) > 1e-4
    assert left(1e-2) / left(1e-3) == pytest.approx(100.0, rel=0.01)


@pytest.mark.parametrize("name", ["brown", "brown-affine-last", "brown-scale-first", "ebner", "gruen", "brown-forward"])
def test_without_coefficients_a_model_is_free_of_distortion(name):
    model = CAMERA_MODELS[name]
    given = {"principal_distance": 28.4, "x0": 1250.0, "y0": 840.5, "pixel_size": 0.0061, "y_axis": -1.0}
    interior = tuple(given.get(element, 0.0) for element in model.elements)
    expected = computed(DISTORTION_FREE, (28.4, 1250.0, 840.5, 0.0061, -1.0), PHOTO_VECTOR, (2480.3, 1920.8))
    np.testing.assert_allclose(computed(model, interior, PHOTO_VECTOR, (2480.3, 1920.8)), expected, rtol=1e-12)


def test_balanced_distortion_vanishes_at_its_zero():
    model, r0 = CAMERA_MODELS["aicon"], 9.5
    interior = (28.4, 0.0, 0.0, -1.3e-4, 2.1e-7, -3e-10, 0.0, 0.0, 0.0, 0.0, r0, 1.0, 1.0)
    point = (0.6 * r0, -0.8 * r0)
    np.testing.assert_allclose(computed(model, interior, (*point, -28.4), point), 0.0, atol=1e-14)


# Orthogonal corrections


def vectors_on_the_grid(points, b=1.0):
    """Corrections as rows over the grid, dx and dy of each point; then shifts, scale, rotation and tilts."""
    x, y = (jnp.asarray(axis.ravel()) for axis in np.meshgrid(*[np.linspace(-b, b, points)] * 2))
    T, U = polynomials(points, x, b), polynomials(points, y, b)
    zero, one = np.zeros(points**2), np.ones(points**2)
    corrections = [
        [zero if term is None else one * term.factor * T[term.i] * U[term.j] for term in correction]
        for correction in orthogonal_corrections(points)
    ]
    tilts = [[T[2], x * y], [x * y, U[2]]]
    orientation = [[one, zero], [zero, one], [x, y], [-y, x], *tilts]
    return np.array(corrections).reshape(-1, 2 * points**2), np.array(orientation).reshape(6, -1)


@pytest.mark.parametrize("points, count", [(3, 12), (5, 44)])
def test_corrections_are_orthogonal_on_their_grid(points, count):
    corrections, orientation = vectors_on_the_grid(points)
    rows = np.concatenate([corrections, orientation])
    assert len(corrections) == count and len(rows) == 2 * points**2
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    np.testing.assert_allclose(rows @ rows.T, np.eye(len(rows)), atol=1e-14)  # and complete: as many as coordinates


@pytest.mark.parametrize("model, points", [(EBNER, 3), (GRUEN, 5)])
def test_a_model_applies_the_corrections(model, points):
    """On the grid itself, one coefficient of 1 at a time."""
    b = 40.0
    corrections, _ = vectors_on_the_grid(points, b)
    grid = tuple(axis.ravel() for axis in np.meshgrid(*[np.linspace(-b, b, points)] * 2))
    given = {"principal_distance": 100.0, "grid_base": b, "pixel_size": 1.0, "y_axis": 1.0}
    for k in range(len(corrections)):
        interior = tuple(given.get(e, 1.0 if e[1:] == str(k + 1) and e[0] in "eg" else 0.0) for e in model.elements)
        v = computed(model, interior, (*grid, np.full(points**2, -100.0)), grid)
        np.testing.assert_allclose(-v.ravel(), corrections[k], rtol=1e-12, atol=1e-12 * abs(corrections[k]).max())


# Several models


def test_a_mixture_of_one_kind_is_that_kind():
    assert mixture((BROWN, BROWN)) is BROWN


def test_a_mixture_computes_with_the_right_model():
    model = mixture((*CAMERA_MODELS.values(), BROWN))
    length = len(model.elements)
    program, derivatives = residual(model), jax.jit(jax.jacrev(residual(model)))
    for number, name in enumerate(CAMERA_MODELS):
        own = arguments(name)
        values = np.array([*own[:-5], *[1.0] * (length - len(own) + 4), number, *own[-5:]])
        np.testing.assert_allclose(program(values), residual(CAMERA_MODELS[name])(own), rtol=1e-12, atol=2e-11)
        found, padding = derivatives(values), slice(len(own) - 5, length)
        assert_same_derivatives(np.delete(found, padding, 1), complex_step(CAMERA_MODELS[name], own))
        np.testing.assert_array_equal(found[:, padding], 0.0)


PX = {"principal_distance": 100.0, "x0": 8670.0, "y0": 5660.0, "pixel_size": 0.006, "y_axis": -1.0}
MM = {"principal_distance": 100.0, "x0": 0.05, "y0": -0.03, "pixel_size": 1.0, "y_axis": 1.0}
PLANTED = {
    "brown-affine-last": {**PX, "K1": -2e-6, "P1": 3e-6, "b1": 2e-4, "b2": -1e-4},
    "aicon": {**MM, "A1": -2e-6, "A2": 2e-10, "B1": 3e-6, "C1": 1e-4, "C2": 2e-4, "R0": 40.0},
    "ebner": {**MM, "e1": 2e-4, "e2": -1e-4, "e3": 1e-6, "e5": 1e-6, "e8": 3e-8, "e12": 2e-10, "grid_base": 41.6},
}
NOT_ESTIMATED = {"ebner": ("x0", "y0")}


def planted_block() -> tuple[Block, np.ndarray]:
    """Two strips whose images are taken in turn with three cameras; exact rays, coefficients unknown; and the truth."""
    camera = AerialCamera(100.0, 104.0, 68.0)
    simulation = simulate(
        2, 6, camera=camera, forward_overlap=0.7, side_overlap=0.4, relief=400.0, control_rows=3, noise=0.0, seed=4
    )
    models = [CAMERA_MODELS[name] for name in PLANTED]
    truth = np.ones((len(models), max(len(model.elements) for model in models)))
    start, free = truth.copy(), np.zeros(truth.shape, bool)
    for row, (name, given) in enumerate(PLANTED.items()):
        for k, element in enumerate(models[row].elements):
            truth[row, k] = start[row, k] = given.get(element, 0.0)
            if element in given and element not in (*HELD, *NOT_ESTIMATED.get(name, ())):
                free[row, k] = True
                start[row, k] = {"principal_distance": 100.2, "x0": 8666.0, "y0": 5667.0}.get(element, 0.0)
    start[1, 1:3] = 0.0
    cameras = tuple(
        Camera(name, model, "px" if PLANTED[name]["y_axis"] < 0 else "mm")
        for name, model in zip(PLANTED, models, strict=True)
    )
    changed = {"cameras": cameras, "image_camera": np.arange(12, dtype=np.int32) % 3, "interior_free": free}
    structure: Structure = dataclasses.replace(simulation.truth.structure, **changed)

    def with_interior(block: Block, elements: np.ndarray) -> Block:
        return eqx.tree_at(
            lambda b: b.interior.elements, dataclasses.replace(block, structure=structure), jnp.asarray(elements)
        )

    coordinates, left = exact_coordinates(with_interior(simulation.truth, truth))
    assert np.abs(left).max() < 1e-11
    block = with_interior(simulation.block, start)
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(coordinates)), truth


def test_an_adjustment_recovers_planted_parameters():
    """One camera of each family in one block: brown, forward and additional parameters."""
    block, truth = planted_block()
    adjustment = adjust(block, precision=False)
    assert adjustment.status == Status.CONVERGED and float(adjustment.sigma0) < 1e-8
    free = block.structure.interior_free
    np.testing.assert_allclose(np.asarray(adjustment.block.interior.elements)[free], truth[free], rtol=1e-8)


def test_simulated_cameras_have_any_model():
    camera = AerialCamera(distortion="gruen", coefficients={"g7": 1e-7}, estimate=("g7", "g44"))
    assert dict(zip(GRUEN.elements, camera.interior().values(), strict=True))["grid_base"] == pytest.approx(92.0)
    structure = simulate(camera=camera).truth.structure
    assert structure.model is GRUEN and structure.interior_free.sum() == 2
    with pytest.raises(ValueError, match="no camera model 'mirror'; there are none, brown"):
        simulate(camera=AerialCamera(distortion="mirror"))
    with pytest.raises(ValueError, match="no interior element grid_base, K9; there are principal_distance, x0"):
        simulate(camera=AerialCamera(distortion="ebner", estimate=("grid_base", "K9")))
