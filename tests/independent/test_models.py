"""Independent models: how they are formed, adjusted, and what they start."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.bare_blocks import without_start

import jaxbundle as jb
from jaxbundle.block.findings import Kind
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.independent import propagation
from jaxbundle.independent.chains import chains
from jaxbundle.independent.formation import Models
from jaxbundle.independent.model_adjustment import fixed_interior, formed
from jaxbundle.independent.sensors import factor_numbers, unwhitened
from jaxbundle.independent.translated import kind_of_sensors

pytestmark = pytest.mark.xdist_group("models")


@pytest.fixture(scope="module")
def simulation() -> jb.planning.Simulation:
    return jb.simulate(2, 4, control_sigma=0.02, points_per_image=30, station_sigma=0.2, seed=2)


@pytest.fixture(scope="module")
def result(simulation) -> jb.independent.ModelAdjustment:
    return jb.independent.adjust_models(simulation.block)


def strips_of(block: jb.Block) -> list[list[int]]:
    return chains(block.structure, np.asarray(block.exterior.projection_centre), np.asarray(block.object_points))


def test_strips_are_found(simulation):
    assert strips_of(simulation.block) == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert strips_of(jb.simulate(3, 5, side_overlap=0.6).block) == [list(range(k, k + 5)) for k in (0, 5, 10)]


@pytest.mark.thorough
def test_models_of_a_block_without_orientations(simulation, result):
    """Found from the rays, stations and control first: the adjustment ends at the same points."""
    found = jb.independent.adjust_models(without_start(simulation.block))
    at = {int(p): k for k, p in enumerate(found.points)}
    common = [p for p in result.points if int(p) in at]
    assert len(common) > 0.9 * len(result.points)
    new = found.object_points[[at[int(p)] for p in common]]
    old = result.object_points[np.isin(result.points, common)]
    assert np.median(np.abs(new - old)) < 0.02
    assert any(f.kind is Kind.APPROXIMATED for f in found.findings)


def test_errors_of_models(result):
    """The five elements have unit variance in their own units, and are independent of what belongs to one point."""
    models: Models = result.models
    for m in range(len(models)):
        used = models.used[m]
        elements, own = models.elements[m, used], models.own[m, used]
        np.testing.assert_allclose(np.einsum("pae,pbe->ab", elements, elements), np.eye(5), atol=1e-6)
        across = np.einsum("pke,pae->pka", own, elements) / np.linalg.norm(own, axis=(1, 2))[:, None, None]
        assert np.abs(across).max() < 1e-5


def test_model_points_lie_where_they_are(simulation, result):
    """Against true model coordinates at the length of the base: within five of their standard deviations."""
    truth, models = simulation.truth, result.models
    centres, points = np.asarray(truth.exterior.projection_centre), np.asarray(truth.object_points)
    rotations = np.asarray(unknowns_of(truth).rotation).T.reshape(-1, 3, 3)
    for m, (i, j) in enumerate(models.pair):
        used, scale = models.used[m], np.linalg.norm(models.base[m]) / np.linalg.norm(centres[j] - centres[i])
        expected = scale * (points[models.point[m, used]] - centres[i]) @ rotations[i]
        q = models.own[m, used] @ models.own[m, used].transpose(0, 2, 1)
        q += models.shared[m, used] @ models.shared[m, used].transpose(0, 2, 1)
        v = models.coordinates[m, used] - expected
        assert np.sqrt(np.mean(np.einsum("pi,pij,pj->p", v, np.linalg.inv(q), v) / 3)) < 2.5


def test_adjusted_to_the_truth(simulation, result):
    adjustment, truth = result.adjustment, simulation.truth
    assert adjustment.status is jb.Status.CONVERGED and adjustment.redundancy > 50
    assert abs(float(adjustment.sigma0) - 1) < 0.25
    sd = np.asarray(adjustment.standard_deviations.object_points)[: len(result.points)]
    difference = result.object_points - np.asarray(truth.object_points)[result.points]
    assert np.sqrt(np.mean((difference / sd) ** 2)) < 1.5
    exterior = np.hstack([truth.exterior.projection_centre, truth.exterior.angles])
    assert np.sqrt(np.mean(((result.oriented.exterior - exterior) / result.oriented.standard_deviations) ** 2)) < 2
    np.testing.assert_array_equal(result.block.exterior.projection_centre, result.oriented.exterior[:, :3])
    assert np.isfinite(np.asarray(result.block.object_points)).all()


def test_projection_centres_are_tie_points(result):
    structure = result.adjustment.block.structure
    first, second = structure.image_names[:2]
    assert (first, second) == ("1_01-1_02", "1_02-1_03")
    shared = structure.point_names.index("centre of 1_02")
    seen = {structure.image_names[i] for i in structure.ray_image[structure.ray_point == shared]}
    assert seen == {first, second}
    observed = [g for g in result.adjustment.block.groups if g.structure.kind is jb.observations.CONTROL]
    assert sum(g.count for g in observed) == 3 * (6 + 8)  # control points and observed stations


def test_residuals_in_the_unit_of_the_object():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(4, 3, 3))
    q, v = a @ a.transpose(0, 2, 1), rng.normal(size=(4, 3))
    numbers = factor_numbers(q)
    white = np.linalg.solve(np.linalg.cholesky(q), v[..., None])[..., 0]
    np.testing.assert_allclose(unwhitened(white, numbers), v, atol=1e-12)


def test_a_kind_that_touches_images_touches_models():
    """Attitudes: the rotation of the image is that of the model times the constant one."""
    kind = jb.observations.ATTITUDES["omega-phi-kappa"]
    new = kind_of_sensors(kind)
    assert new is kind_of_sensors(kind)
    assert new.touches[:2] == ("image", "point") and new.touches[2:] == kind.touches[1:]
    turned, identity = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0), (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)
    image, zeros = ((1.0, 2.0, 3.0), identity), (0.0,) * 9
    of_image = kind.residuals((((4.0, 5.0, 6.0), turned), *zeros), (0.0,) * 3, (0.0,))
    of_model = new.residuals((image, (4.0, 5.0, 6.0), *zeros), (0.0,) * 3, (0.0, *turned))
    np.testing.assert_allclose(of_model, of_image)


def test_report_has_the_tables_of_the_bundle(result, tmp_path, monkeypatch):
    """The same columns of photographs and points, and the models themselves."""
    monkeypatch.setattr(propagation, "MAX_UNKNOWNS", 0)  # the dense design matrix has a test of its own
    folder = jb.report.write_method_report(result, tmp_path / "models")
    data = json.loads((folder / "report.json").read_text())
    assert set(data["files"]) == {path.name for path in folder.iterdir()}
    assert data["method_of_adjustment"] == "models" and data["sigma0"] == float(result.adjustment.sigma0)
    assert data["images"]["1_02"]["X0"][0] == float(result.block.exterior.projection_centre[1, 0])
    assert set(data["models"]["1_01-1_02"]) >= {"X0", "Y0", "Z0", "omega", "phi", "kappa", "scale"}
    head = (folder / "points.csv").read_text().splitlines()[0]
    assert head == "point,X,Y,Z,sX,sY,sZ,rays"
    text = (folder / "report.txt").read_text()
    assert "independent models, 6 of two images, 7 unknowns each" in text and "centre of" not in data["points"]


def test_gross_errors_leave_their_model(simulation):
    block = simulation.block
    wrong = int(np.flatnonzero(block.structure.ray_image == 1)[5])
    coordinates = np.array(block.rays.coordinates)
    coordinates[wrong, 1] += 0.5
    models, told = formed(_with_rays(block, coordinates), None)
    (finding,) = [f for f in told if f.kind is Kind.SUSPECT]
    name = block.structure.point_names[block.structure.ray_point[wrong]]
    assert any(subject.names == ("1_02", name) for subject in finding.subjects)
    assert "left out of models, because their rays do not intersect" in finding.words and len(models) == 6


def _with_rays(block: jb.Block, coordinates: np.ndarray) -> jb.Block:
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(coordinates))


def test_what_cannot_be_formed_is_told(simulation):
    block = simulation.block
    with pytest.raises(jb.BlockError, match="a model names image 9_99, which is not in the block"):
        jb.independent.adjust_models(block, pairs=[("1_01", "9_99")])
    with pytest.raises(jb.BlockError, match="a model has image 1_01 twice"):
        jb.independent.adjust_models(block, pairs=[("1_01", "1_01")])
    with pytest.raises(jb.BlockError, match="a model names image 9_99, which is not in the block"):
        jb.independent.plan_height(block, pairs=[("1_01", "9_99")])
    with pytest.raises(jb.BlockError, match="9_99, which is not in the block"):
        jb.independent.adjust_strips(block, strips=[["1_01", "9_99"]])
    with pytest.raises(jb.BlockError, match="no two images form a model"):
        formed(block, [])
    _, told = formed(block, [("1_01", "1_02"), ("1_03", "1_04"), ("2_01", "2_02")])
    words = [finding.words for finding in told]
    assert any(w.startswith("2 images in no model: 2_03, 2_04") for w in words)
    estimated = jb.simulate(1, 2, camera=jb.planning.AerialCamera(estimate=("principal_distance",))).block
    (told,) = fixed_interior(estimated)
    assert told.words.startswith("the interior elements camera principal_distance are fixed")
