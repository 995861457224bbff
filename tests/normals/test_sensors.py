"""A sensor is what sees points by one differentiable function: point clouds with 7 or 9 unknowns and 3 residuals."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.dense_adjustment import centred, dense_cofactors, dense_system, free_values
from cases.dense_steps import assert_dense_steps
from cases.point_clouds import MODEL, STRIP, point_clouds

import jaxbundle as jb

pytestmark = pytest.mark.xdist_group("sensors")
BLOCKS = {
    "models of one scale": lambda: point_clouds(MODEL, shared=True),
    "strips": lambda: point_clouds(STRIP),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_steps(name):
    assert_dense_steps(BLOCKS[name](), "auto")


@pytest.fixture(scope="module", params=BLOCKS)
def result(request) -> jb.Adjustment:
    """By the program of the steps."""
    return jb.adjust(BLOCKS[request.param](), method="gauss-newton")


def test_adjusted(result):
    """The noise is found again: sigma0 is 1 within its own standard deviation of 1 / sqrt(2 r) = 0.03, three times."""
    assert result.trustworthy
    assert abs(float(result.sigma0) - 1) < 3 / np.sqrt(2 * result.redundancy)


def test_standard_deviations(result):
    unknowns, observations = centred(result.block)
    expected = float(result.sigma0) * np.sqrt(np.diagonal(dense_cofactors(unknowns, observations)))
    sd = result.standard_deviations
    found = free_values(
        sd.projection_centre.T, sd.angles.T, sd.interior.T, sd.parameters, sd.object_points.T, observations
    )
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_redundancy_numbers(result):
    system = dense_system(*centred(result.block))
    leverages = np.sum(np.linalg.qr(system.design / system.lengths)[0] ** 2, 1)
    assert result.redundancy_numbers is not None
    found = np.concatenate([np.asarray(r).T.ravel() for r in result.redundancy_numbers])
    observed = system.design.any(1)
    np.testing.assert_allclose(found[observed], 1 - leverages[observed], atol=1e-8)
    assert found.sum() == pytest.approx(result.redundancy, rel=1e-8)


def test_derivative():
    """An adjusted coordinate by a measured one, against differences."""
    block = BLOCKS["models of one scale"]()

    def height(shift: jax.Array) -> jax.Array:
        moved = eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates.at[17, 2].add(shift))
        return jb.adjust(moved, method="gauss-newton", precision=False).block.object_points[
            int(block.structure.ray_point[17]), 2
        ]

    step = 1e-4
    differences = (float(height(jnp.asarray(step))) - float(height(jnp.asarray(-step)))) / (2 * step)
    assert float(jax.grad(height)(jnp.asarray(0.0))) == pytest.approx(differences, rel=1e-5)


def test_photographs_and_models_in_one_block():
    block = point_clouds(MODEL)
    camera = block.structure.cameras[0]
    cameras = (jb.blocks.Camera(camera.name, jb.cameras.CAMERA_MODELS["none"], "mm"), *block.structure.cameras[1:])
    mixed = eqx.tree_at(lambda b: b.interior.elements, block, jnp.ones((len(cameras), 5)))
    mixed = dataclasses.replace(mixed, structure=dataclasses.replace(block.structure, cameras=cameras))
    (problem,) = jb.blocks.validate(mixed)
    assert problem.what == "cameras c0 and c7 measure different numbers of coordinates of a ray"


def test_statistics_take_any_sensor(result):
    block, point = result.block, int(np.flatnonzero(result.block.structure.point_free.all(1))[0])
    found = jb.covariance_of(result, lambda b: b.object_points[point])
    np.testing.assert_allclose(found.standard_deviations, result.standard_deviations.object_points[point], rtol=1e-7)
    ratio = jb.statistics.reliability(result).w[0]
    assert ratio.shape == result.residuals[0].shape == (len(block.structure.ray_image), 3)
    assert jb.blocks.plausibility(block) == () and jb.blocks.prepared(block)[0] is block
    components = jb.statistics.variance_components(block, options=result.options, max_rounds=1)
    assert components.names[0] == "rays of control points"


def test_what_looks_at_image_points_says_so(result, tmp_path):
    told = [f.words for f in jb.findings(result, result.block) if "not photographs" in f.words]
    assert len(told) == 1 and not (tmp_path / "report").exists()
    for refused in (
        lambda: jb.snoop(result),
        lambda: jb.write_report(result, tmp_path / "report"),
        lambda: jb.stopping.parallax_rule(result.block, 1e-6),
    ):
        with pytest.raises(
            ValueError, match="takes photographs only; the sensor '(model|correlated strip)' .* 3 residuals per point"
        ):
            refused()
