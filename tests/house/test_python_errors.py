"""What a user of the Python interface gets wrong is told in one sentence with its cure; what he looks at is short."""

import dataclasses
import importlib.metadata
import tomllib
from operator import attrgetter
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.simulated_blocks import small_block

import jaxbundle as jb
from jaxbundle.block.findings import Kind
from jaxbundle.solve import reweighting as solve_reweighting
from jaxbundle.solve.adjustment import Status
from jaxbundle.statistics.covariance import Estimated


@pytest.fixture(scope="module")
def block():
    return small_block().block


@pytest.fixture(scope="module")
def result(block):
    return jb.adjust(block)


OF_BLOCKS = {
    "adjust": (),
    "planning.predict": (),
    "statistics.variance_components": (),
    "blocks.validate": (),
    "blocks.with_datum": (),
    "blocks.with_interior_held": (),
    "blocks.datum_defect": (),
    "orientation.intersect": (),
    "stopping.parallax_rule": (1e-6,),
    "stopping.unknown_rule": (1e-6,),
    "statistics.all_control": (),
    "statistics.camera_rays": ("camera",),
    "statistics.control_point": ("1",),
    "statistics.control_rays": (),
    "statistics.image_rays": ((), "strip"),
    "statistics.observations_of_kind": ("control",),
    "statistics.default_groups": (),
    "statistics.tie_rays": (),
}
OF_ADJUSTMENTS = {
    "snoop": (),
    "statistics.reliability": (),
    "covariance_of": (lambda b: b.object_points,),
    "statistics.error_ellipses": (),
    "statistics.error_ellipsoids": (),
    "statistics.control_influence": (),
    "statistics.influence": (None,),
}


@pytest.mark.parametrize("name", OF_BLOCKS)
def test_functions_of_a_block(name, result, unchecked_types):
    function, more = attrgetter(name)(jb), OF_BLOCKS[name]
    for given, cure in (
        ("folder", "jb.read('folder')"),
        (Path("folder"), "jb.read('folder')"),
        (None, 'jb.read("folder")'),
        (result, "adjustment.block"),
    ):
        with pytest.raises(TypeError) as caught:
            function(given, *more)
        assert str(caught.value).startswith(f"{name} takes a Block, not ")
        assert str(caught.value).endswith(f": call jb.{name}({cure})")


@pytest.mark.parametrize("name", OF_ADJUSTMENTS)
def test_functions_of_an_adjustment(name, block, unchecked_types):
    function, more = attrgetter(name)(jb), OF_ADJUSTMENTS[name]
    for given, cure in ((block, "jb.adjust(block)"), ("folder", "jb.adjust(jb.read('folder'))")):
        with pytest.raises(TypeError) as caught:
            function(given, *more)
        assert str(caught.value).startswith(f"{name} takes an Adjustment, not ")
        assert str(caught.value).endswith(f": call jb.{name}({cure})")


@pytest.mark.parametrize("given", ["folder", ["folder"], {"one": "folder"}, None])
def test_many_blocks(given, block, unchecked_types):
    with pytest.raises(TypeError, match="takes a Block|takes several Blocks"):
        jb.adjust_many(given)
    with pytest.raises(TypeError, match="takes several Blocks"):
        jb.adjust_many(block)


def test_covariance_of_several_points(result):
    """The shape of the function is that of the values, and twice that of the covariance."""
    points = jnp.array([3, 7])
    found = jb.covariance_of(result, lambda b: b.object_points[points])
    assert found.values.shape == (2, 3) and found.covariance.shape == (2, 3, 2, 3)
    sd = np.asarray(result.standard_deviations.object_points)[[3, 7]]
    np.testing.assert_allclose(found.standard_deviations, sd, rtol=1e-8)
    matrix = float(result.sigma0) ** 2 * np.asarray(result.cofactors.object_points)[7]
    np.testing.assert_allclose(found.covariance[1, :, 1, :], matrix, rtol=1e-8)
    flat = jb.covariance_of(result, lambda b: b.object_points[points].ravel())
    np.testing.assert_allclose(found.covariance.reshape(6, 6), flat.covariance, rtol=1e-12)


def test_shapes_of_one_number():
    found = Estimated(np.array(2.0), np.array(9.0))
    assert found.standard_deviations.shape == () and found.standard_deviations == 3.0


def test_covariance_of_one_number(result):
    found = jb.covariance_of(result, lambda b: b.object_points[3, 2])
    assert found.values.shape == found.covariance.shape == found.standard_deviations.shape == ()


WRONG_FUNCTIONS = {
    "the function returns NoneType, not an array": lambda b: None,
    "the function returns str, not an array": lambda b: "X",
    "the function returns tuple, not an array": lambda b: (b.object_points[0], b.object_points[1]),
    "the function returns an array of int64": lambda b: jnp.arange(3),
    "the function returns an array without elements": lambda b: b.object_points[:0],
    "1 of 1 values of the function are not finite": lambda b: jnp.log(-jnp.abs(b.object_points[0, 0]) - 1),
    "derivatives of the function with respect to the object_points are not finite": (
        lambda b: jnp.linalg.norm(b.object_points[0] - b.object_points[0])
    ),
    "the function cannot be differentiated (TracerArrayConversionError": (
        lambda b: np.linalg.norm(np.asarray(b.object_points[0]))
    ),
    "the function fails with AttributeError": lambda b: b.corners,
}


@pytest.mark.parametrize("words", WRONG_FUNCTIONS)
def test_covariance_of_what_is_none(result, words):
    with pytest.raises((TypeError, ValueError)) as caught:
        jb.covariance_of(result, WRONG_FUNCTIONS[words])
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_covariance_of_no_function(result, unchecked_types):
    with pytest.raises(TypeError, match="needs a function of the block, not ArrayImpl"):
        jb.covariance_of(result, result.block.object_points)


@pytest.mark.thorough
def test_robust_precision_has_the_weights_of_the_last_round(block):
    """Standard deviations, covariances and reliability are of one adjustment."""
    ray = 5
    shifted = block.rays.coordinates.at[ray].add(60 * block.rays.sigmas[ray])
    result = jb.adjust(eqx.tree_at(lambda b: b.rays.coordinates, block, shifted), robust=jb.robust.Huber())
    assert result.reweighting is not None
    weight = float(result.reweighting.weights[ray])
    assert weight < 0.2
    point = int(block.structure.ray_point[ray])
    found = jb.covariance_of(result, lambda b: b.object_points[point])
    np.testing.assert_allclose(found.standard_deviations, result.standard_deviations.object_points[point], rtol=1e-7)
    tables = jb.statistics.reliability(result)
    sigma = np.asarray(block.rays.sigmas)[ray] / np.sqrt(weight)
    ratio = tables.minimal_detectable[0][ray] * np.sqrt(tables.redundancy_numbers[0][ray]) / sigma
    np.testing.assert_allclose(ratio, 4.1321, rtol=1e-3)


def test_robust_rounds_end_where_the_adjustment_does_not_converge(block, monkeypatch):
    """Two rounds in a row are enough."""
    counted = []
    original = jb.adjust(block, max_iterations=1, precision=False)
    assert original.status is Status.MAXIMUM_ITERATIONS

    def never(block):
        counted.append(block)
        return dataclasses.replace(original, block=block)

    ended = solve_reweighting.adjust_robustly(block, jb.robust.Tukey(), solve_reweighting.Solve(never, never))
    assert len(counted) == 2 + solve_reweighting.FAILED_ROUNDS
    assert ended.reweighting is not None and not ended.reweighting.settled and not ended.trustworthy
    (found,) = [finding for finding in ended.findings if finding.kind is Kind.UNSETTLED]
    assert "in round 2 the adjustment stopped at the maximum number of iterations" in found.what


def test_names_are_shown():
    assert "__version__" in dir(jb)
    assert not [name for name in dir(jb) if name.startswith("_") and name != "__version__"]
    with (Path(__file__).parents[2] / "pyproject.toml").open("rb") as file:
        assert tomllib.load(file)["tool"]["setuptools"]["dynamic"]["version"]["attr"] == "jaxbundle.__version__"
    assert jb.__version__ == importlib.metadata.version("jaxbundle")


def test_blocks_and_results_are_shown_in_one_line(block, result):
    images, points = len(block.structure.image_names), len(block.structure.point_names)
    rays = len(block.structure.ray_image)
    assert repr(block).startswith(f"<Block 2 x 4 images: {images} images, {points} points, {rays} rays, 1 camera, ")
    assert repr(result).startswith("<Adjustment 2 x 4 images: converged, sigma0 ")
    assert repr(result).endswith(f", {images} images, {points} points>")
    seen = []
    jax.jit(lambda a: seen.append(repr(a)))(result)
    assert seen == [f"<Adjustment 2 x 4 images: traced, or many adjustments, {images} images, {points} points>"]
    assert repr(jax.tree.map(lambda x: jnp.stack([x, x]), result)) == seen[0]
