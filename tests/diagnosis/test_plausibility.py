"""Plausibility before the adjustment: the likely cause is named, and nothing is said of a block that is right."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.mistaken_folders import made

import jaxbundle as jb
from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.diagnosis.before import plausibility, prepared
from jaxbundle.orientation.intersection import intersect

CLEAN_CASES = (
    "01-gcp-axes-swapped/cured",
    "04-gcps-on-a-line/line-with-noise",
    "04-gcps-on-a-line/two-close",
    "06-no-parallax/far-converging",
    "10-vertical-datum/with-shift",
    "12-boresight/unknown",
    "14-disconnected/control-in-both",
    "18-file-dialects/plain",
    "35-plan-as-approximation/true-approx",
    "36-which-ray/b",
)
DATA_SETS = ("strasbourg-s1-fixed", "strasbourg-s4-tie", "camcal-c1-fixed", "camcal-selfcal-3", "roma")
BAL = ("dubrovnik-3-7-pre.txt", "ladybug-49-shrink-1800.txt")


@pytest.fixture(scope="module")
def simulated() -> Block:
    """Two strips, control weighted, start rough."""
    return jb.simulate(2, 4, points_per_image=20, control_sigma=0.05, control_rows=3, seed=1).block


def first(block: Block) -> Finding:
    return plausibility(block)[0]


def components(found: Finding) -> tuple[str, set[str]]:
    return found.subjects[0].table, {name for subject in found.subjects for name in subject.names}


@pytest.mark.parametrize("name", DATA_SETS)
def test_nothing_is_said_of_real_blocks(shared_data, name):
    block = jb.read(shared_data / name, check_start=False)
    assert prepared(block) == (block, ())


@pytest.mark.parametrize("name", BAL)
def test_nothing_is_said_of_bal(shared_data, name):
    block = jb.read(shared_data / "bal" / name, check_start=False)
    assert prepared(block) == (block, ())


@pytest.mark.parametrize("case", CLEAN_CASES)
def test_nothing_is_said_of_right_blocks(shared_data, case):
    block = jb.read(shared_data / "cases" / case, check_start=False)
    assert prepared(block) == (block, ())


@pytest.mark.parametrize("mistake", ["a00", "a28", "a31", "a32", "a42", "a44", "a49"])
def test_what_the_start_does_not_tell_is_not_said(shared_data, tmp_path: Path, mistake):
    block = jb.read(made(shared_data, mistake, tmp_path), check_start=False)
    assert prepared(block) == (block, ())


def test_nothing_is_said_of_simulated_blocks(simulated):
    blocks = [jb.simulate(2, 4, points_per_image=20, control_sigma=0.05, control_rows=3, seed=k).block for k in (0, 1)]
    for block in blocks:
        assert prepared(block) == (block, ())
    block = blocks[1]
    points = jnp.where(np.arange(len(block.object_points))[:, None] < 9, block.object_points, jnp.nan)
    without = intersect(eqx.tree_at(lambda b: b.object_points, block, points))
    assert prepared(without) == (without, ())


@pytest.mark.parametrize(
    ("mistake", "cause"),
    [
        ("a06", "x and y exchanged"),
        ("a08", "origin in the centre"),
        ("a09", "as mm"),
        ("a48", "width and height exchanged"),
    ],
)
def test_rays_and_format(shared_data, tmp_path: Path, mistake, cause):
    (found,) = plausibility(jb.read(made(shared_data, mistake, tmp_path), check_start=False))
    assert (found.kind, found.severity) == (Kind.FORMAT, Severity.FAILED)
    assert found.subjects == (Subject("cameras", ("scan",)),)
    assert cause in found.what


@pytest.mark.parametrize(("mistake", "component"), [("a07", "y"), ("a72", "x")])
def test_mirrored_images(shared_data, tmp_path: Path, mistake, component):
    (found,) = plausibility(jb.read(made(shared_data, mistake, tmp_path), check_start=False))
    assert (found.kind, found.severity) == (Kind.FORMAT, Severity.FAILED)
    assert found.subjects[0] == Subject("rays", (), component)


def test_mirrored_images_of_a_block_without_points(simulated):
    rays = simulated.rays.coordinates * jnp.array([[1.0, -1.0]])
    block = eqx.tree_at(lambda b: b.rays.coordinates, simulated, rays)
    points = jnp.where(np.arange(len(block.object_points))[:, None] < 9, block.object_points, jnp.nan)
    found = first(intersect(eqx.tree_at(lambda b: b.object_points, block, points)))
    assert (found.kind, found.subjects[0]) == (Kind.FORMAT, Subject("rays", (), "y"))


def test_a_single_ray_outside_of_the_format(shared_data):
    block = jb.read(shared_data / "strasbourg-s4-tie", check_start=False)
    s = block.structure
    wrong = eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates.at[7, 0].add(1e4))
    (found,) = plausibility(wrong)
    names = s.image_names[s.ray_image[7]], s.point_names[s.ray_point[7]]
    assert (found.kind, found.severity) == (Kind.FORMAT, Severity.CHECK)
    assert found.subjects == (Subject("rays", names),)


def test_images_of_half_resolution(shared_data):
    block = jb.read(shared_data / "strasbourg-s4-tie", check_start=False)
    half = np.where(np.isin(block.structure.ray_image, [1, 3])[:, None], 0.5, 1.0)
    (found,) = plausibility(eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates * half))
    assert (found.kind, found.severity) == (Kind.FORMAT, Severity.FAILED)
    assert found.subjects == (Subject("images", ("8936",)), Subject("images", ("8938",)))


@pytest.mark.parametrize(
    ("mistake", "cause"), [("a22", "in px"), ("a23", "in mm"), ("a24", "in m:"), ("a26", "micrometres")]
)
def test_principal_distance_and_format(shared_data, tmp_path: Path, mistake, cause):
    (found,) = plausibility(jb.read(made(shared_data, mistake, tmp_path), check_start=False))
    assert (found.kind, found.severity) == (Kind.INTERIOR, Severity.FAILED)
    assert found.subjects == (Subject("cameras", ("scan",), "principal_distance"),)
    assert found.unit == "deg"
    assert cause in found.cure


@pytest.mark.parametrize(("mistake", "cause"), [("a20", "X and Y exchanged"), ("a27", "divided by 1000")])
def test_control_in_another_system(shared_data, tmp_path: Path, mistake, cause):
    (found,) = plausibility(jb.read(made(shared_data, mistake, tmp_path), check_start=False))
    assert (found.kind, found.severity) == (Kind.CONTROL_SYSTEM, Severity.FAILED)
    assert components(found)[0] == "control"
    assert cause in found.what


def test_a_left_handed_object_system(shared_data, tmp_path: Path):
    (found,) = plausibility(jb.read(made(shared_data, "a21", tmp_path), check_start=False))
    assert (found.kind, found.severity) == (Kind.CONTROL_SYSTEM, Severity.FAILED)
    assert "X and Y of all coordinates exchanged" in found.what


def test_control_with_another_origin(simulated):
    group = simulated.groups[0]
    values = group.values + jnp.array([[1e5, -3e5, 0.0]])
    found = first(eqx.tree_at(lambda b: b.groups[0].values, simulated, values))
    assert (found.kind, found.severity) == (Kind.CONTROL_SYSTEM, Severity.CHECK)
    assert found.size == pytest.approx(np.hypot(1e5, 3e5), rel=0.01)
    assert "shift" in found.what


@pytest.mark.parametrize("case", ["fixed", "weighted", "weighted-no-approx"])
def test_a_control_point_with_exchanged_axes(shared_data, case):
    (found,) = plausibility(jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / case, check_start=False))
    assert (found.kind, found.severity) == (Kind.CONTROL_SYSTEM, Severity.CHECK)
    assert found.subjects == (Subject("control", ("GCP3",)),)
    assert "X and Y exchanged" in found.what


def test_two_control_points_with_exchanged_names(shared_data, tmp_path: Path):
    (pair,) = plausibility(jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / "pair", check_start=False))
    assert components(pair) == ("control", {"GCP1", "GCP2"})
    (found,) = plausibility(jb.read(made(shared_data, "a43", tmp_path), check_start=False))
    assert components(found) == ("control", {"410", "492"})
    assert "names exchanged" in found.what


@pytest.mark.parametrize(("axis", "error"), [(0, 100.0), (2, 100.0), (0, 1000.0)])
def test_a_control_point_far_off(shared_data, axis, error):
    block = jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / "cured", check_start=False)
    group = block.groups[0]
    point = int(group.structure.indices[2, 0])
    wrong = eqx.tree_at(
        lambda b: (b.groups[0].values, b.object_points),
        block,
        (group.values.at[2, axis].add(error), block.object_points.at[point, axis].add(error)),
    )
    (found,) = plausibility(wrong)
    assert found.subjects == (Subject("control", (block.structure.point_names[point],)),)
    assert found.size == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize(
    ("mistake", "cause", "images"),
    [
        ("a05", "angles in rad", None),
        ("a29", "kappa off by 180 deg", {"8936"}),
        ("a30", "kappa off by 180 deg", None),
        ("a57", "Z0 of opposite sign", None),
        ("a71", "kappa of opposite sign", None),
    ],
)
def test_confused_orientations(shared_data, tmp_path: Path, mistake, cause, images):
    block = jb.read(made(shared_data, mistake, tmp_path), check_start=False)
    told = [found for found in plausibility(block) if found.kind is Kind.START]
    assert [found.severity for found in told] == [Severity.CHECK]
    assert components(told[0]) == ("images", images or set(block.structure.image_names))
    assert cause in told[0].what


@pytest.mark.parametrize("case", ["zero", "mean"])
def test_all_stations_in_one_place(shared_data, case):
    block = jb.read(shared_data / "cases" / "27-equal-start" / case, check_start=False)
    told = [found for found in plausibility(block) if found.kind is Kind.START]
    assert len(told) == 1
    assert "the same approximate projection centre" in told[0].what


@pytest.mark.parametrize("case", ["zero-nopoints", "mean-nopoints"])
def test_all_stations_in_one_place_are_found_from_the_rays(shared_data, case):
    block = jb.read(shared_data / "cases" / "27-equal-start" / case, check_start=False)
    (found,) = plausibility(block)
    assert found.kind is Kind.REPAIRED and components(found) == ("images", set(block.structure.image_names))


@pytest.mark.parametrize("case", ["free-inverted", "flat-control-from-below"])
def test_a_start_on_the_wrong_side(shared_data, case):
    found = plausibility(jb.read(shared_data / "cases" / "33-mirrored-solution" / case, check_start=False))
    assert [f.kind for f in found] == [Kind.START, Kind.REPAIRED]


def test_a_point_in_a_projection_centre(simulated):
    s = simulated.structure
    ray = int(np.flatnonzero(s.point_free.all(1)[s.ray_point])[-1])
    image, point = s.ray_image[ray], s.ray_point[ray]
    points = simulated.object_points.at[point].set(simulated.exterior.projection_centre[image])
    block = eqx.tree_at(lambda b: b.object_points, simulated, points)
    checked, found = prepared(block)
    assert Subject("points", (s.point_names[point],)) in [subject for f in found for subject in f.subjects]
    assert np.isfinite(np.asarray(checked.object_points)).all()


def test_control_points_in_one_place(simulated):
    values = simulated.groups[0].values
    block = eqx.tree_at(lambda b: b.groups[0].values, simulated, values.at[1].set(values[0]))
    kinds = [found for found in plausibility(block) if "same coordinates" in found.what]
    assert components(kinds[0])[1] == {"1", "2"}


@pytest.mark.parametrize("value", [0.0, 1e300, -1e300, 1e-300])
def test_no_number_is_too_large(simulated, value):
    for where in (
        lambda b: b.exterior.projection_centre,
        lambda b: b.exterior.angles,
        lambda b: b.object_points,
        lambda b: b.rays.coordinates,
        lambda b: b.groups[0].values,
        lambda b: b.interior.elements,
    ):
        block = eqx.tree_at(where, simulated, jnp.full(where(simulated).shape, value))
        assert isinstance(plausibility(block), tuple)
