"""What the solver says of itself: converged only at a minimum, and what is undetermined by its cause and its names."""

import dataclasses
import importlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.free_networks import free_network
from cases.gruber_blocks import gruber_block, perimeter, with_control

from jaxbundle.block.block import Block, Datum, Structure
from jaxbundle.block.datum import with_datum
from jaxbundle.block.datum_defect import datum_defect
from jaxbundle.block.datum_precision import datum_precision, weak_datum
from jaxbundle.block.findings import Kind, Severity
from jaxbundle.block.observation_kinds import CONTROL, observation_group
from jaxbundle.block.observed_places import frame_of
from jaxbundle.block.parts import parts_of
from jaxbundle.block.problems import BlockError
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.numerics.conjugate_gradients import softest_direction
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.levenberg_marquardt import FLAT, is_flat
from jaxbundle.solve.similarity_findings import Gauge, gauge_findings


@pytest.fixture(scope="module")
def degenerate(shared_data):
    """Small blocks of one shape."""
    folder = shared_data / "cases" / "fuzz" / "solve"
    return lambda name: read_block_folder(folder / name, check_start=False)


def test_the_gradient_is_held_against_the_residuals_and_their_rounding():
    cost, noise = jnp.asarray(2.0), jnp.asarray(0.0)  # |v| = 2
    assert is_flat(jnp.asarray(1.9 * FLAT), cost, noise, FLAT)
    assert not is_flat(jnp.asarray(2.1 * FLAT), cost, noise, FLAT)
    assert is_flat(jnp.asarray(2.1 * FLAT), cost, jnp.asarray(0.5e-16), FLAT)
    assert not is_flat(jnp.asarray(jnp.nan), cost, noise, FLAT)


@pytest.mark.parametrize("method", ["levenberg-marquardt", "gauss-newton"])
def test_a_block_without_any_residual_converges(method):
    """Level photographs with computed coordinates: v is exactly 0, and so is the change of v."""
    block = gruber_block(2, 2)
    known = perimeter(block)
    found = adjust(with_control(block, known, known), method=method, precision=False)
    assert float(found.vtpv) == 0.0 and float(found.sigma0) == 0.0
    assert found.status is Status.CONVERGED and int(found.iterations.trials) <= 2


@pytest.mark.parametrize("principal_distance", [None, 1e-12])
def test_no_minimum_is_called_converged(degenerate, principal_distance):
    """A large damping makes any step short; unknowns of an end point that is no minimum are not called undetermined."""
    block = degenerate("approx-below-ground-noprec")
    if principal_distance is not None:
        elements = block.interior.elements.at[0, 0].set(principal_distance)
        block = eqx.tree_at(lambda b: b.interior.elements, block, elements)
    found = adjust(block, precision=False)
    assert found.status is not Status.CONVERGED and not found.trustworthy
    assert not found.undetermined


@pytest.mark.parametrize("options", [{}, {"precision": False}, {"precision": False, "reduced": "pcg"}], ids=str)
def test_parts_that_share_one_point(degenerate, options):
    """All rotations and the scale of the part without control are told as such, and do not count as unknowns."""
    found = adjust(degenerate("connected-by-one-point-noprec"), **options)
    (parts,) = found.undetermined
    assert parts.kind is Kind.PARTS and found.undetermined_directions == 4 and not found.trustworthy
    assert found.redundancy == found.block.redundancy + 4
    images = {(subject.names[0], subject.component) for subject in parts.subjects}
    assert images == {("i0", "part 1"), ("i1", "part 1"), ("i2", "part 2"), ("i3", "part 2")}
    assert "2 parts connected by 1 point only (p5)" in parts.what
    assert "all three rotations, the scale of the part of 2 images i2, i3" in parts.what


def test_points_in_a_projection_centre_are_named(degenerate):
    with pytest.raises(BlockError, match="the approximate coordinates of point p5 are those of .* image i0"):
        adjust(degenerate("approx-one-point-in-centre"))


@pytest.mark.parametrize("name", ["control-collinear-3", "strip-control-on-line"])
def test_control_on_a_line_is_refused_whatever_the_approximate_values(degenerate, name):
    with pytest.raises(
        BlockError, match="the rotation about an axis parallel to .*; these lie on one line, the axis: p"
    ):
        adjust(degenerate(name))


def controlled(off: float, sigma: float = 0.02) -> Block:
    """A strip with three control points along X, the middle one `off` beside their line."""
    block = simulate(1, 3, control_rows=0, check_points=0, points_per_image=30).block
    values = np.array([(0.0, 0.0, 0.0), (400.0, off, 0.0), (800.0, 0.0, 0.0)])
    group = observation_group(CONTROL, np.arange(3)[:, None], values, np.full((3, 3), sigma))
    free = np.ones_like(block.structure.exterior_free)
    structure = dataclasses.replace(block.structure, exterior_free=free, datum=Datum("control"))
    return dataclasses.replace(block, structure=structure, groups=(group,))


def test_a_weak_datum_is_told_by_the_standard_deviation_of_its_weakest_direction():
    """Of the rotation about the line: sigma / off, with the share of three points, sqrt(3 / 2)."""
    precision = datum_precision(controlled(10.0))
    assert precision is not None
    along_x = np.sqrt(precision.covariance[3, 3])
    assert along_x == pytest.approx(0.02 / 10.0 * np.sqrt(3 / 2), rel=1e-3)
    assert weak_datum(controlled(10.0), 1.0) == ()
    (found,) = weak_datum(controlled(0.02), 1.0)
    assert found.kind is Kind.IMPRECISE and found.severity is Severity.FAILED
    assert [subject.table for subject in found.subjects] == ["control"] * 3
    assert "the rotation about the line through" in found.what and "70.2 deg" in found.what
    assert weak_datum(controlled(0.02, 1e-4), 1.0) == ()
    assert weak_datum(controlled(0.02), 0.01) == ()  # the sigmas were far too large


def test_parts_of_a_block():
    """Three common points hold two images together, two do not; points seen twice on an image count once."""
    block = simulate(1, 2, points_per_image=30).block
    structure = block.structure

    def seen(*points: tuple[int, ...]) -> Structure:
        image = np.concatenate([np.full(len(p), i) for i, p in enumerate(points)])
        names = tuple(f"i{k}" for k in range(len(points)))
        return dataclasses.replace(
            structure, image_names=names, ray_image=image, ray_point=np.concatenate([*map(np.array, points)])
        )

    whole = parts_of(seen((0, 1, 2, 3), (1, 2, 3, 4), (2, 3, 4)))
    assert len(whole) == 1 and not len(whole[0].common)
    first, second = parts_of(seen((0, 1, 2, 3), (1, 2, 3, 4), (4, 4, 4, 5, 6), (0, 5, 6, 4)))
    assert first.images.tolist() == [0, 1] and second.images.tolist() == [2, 3]
    assert first.common.tolist() == second.common.tolist() == [0, 4]
    # two images each share less than three points with a group, but three in all
    (held,) = parts_of(seen((0, 1, 2, 3, 4), (0, 1, 2), (3, 4, 0)))
    assert len(held.images) == 3


def test_softest_direction_of_a_matrix():
    """The eigenvector of a tiny eigenvalue, and the null vector of a singular matrix."""
    random = np.random.default_rng(5)
    q, _ = np.linalg.qr(random.normal(size=(12, 12)))
    right = jnp.asarray(np.sign(random.normal(size=12)))
    for smallest in (1e-7, 0.0):
        matrix = jnp.asarray(q * np.array([smallest, *np.linspace(0.2, 1.0, 11)]) @ q.T)
        found = softest_direction(lambda x, a=matrix: a @ x, lambda r: r, right, jnp.dot, 1e-11, 1e-9, 100)
        assert abs(float(found @ q[:, 0])) / float(jnp.linalg.norm(found)) == pytest.approx(1.0, abs=1e-6)


def test_good_blocks_keep_their_words():
    """Nothing is found in a good block, with and without standard deviations; a traced one is not looked at."""
    block = with_datum(simulate(1, 3, points_per_image=30, control_rows=2).block)
    for precision in (True, False):
        found = adjust(block, precision=precision)
        assert found.trustworthy and not found.findings and found.undetermined_directions == 0
    arrays, static = eqx.partition(block, eqx.is_array)
    traced = jax.jit(lambda a: adjust(eqx.combine(a, static), precision=False).sigma0)(arrays)
    assert float(traced) == pytest.approx(float(found.sigma0), rel=1e-12)


def test_full_steps_end_what_damped_ones_creep_along(monkeypatch):
    """They reach the minimum of the undisturbed solve; where no step is left for them, the adjustment creeps."""
    block = simulate(strips=2, images=3, points_per_image=12).block
    options = {"precision": False, "devices": 1}
    expected = adjust(block, **options)
    monkeypatch.setattr(importlib.import_module("jaxbundle.solve.adjust"), "is_creeping", lambda _, costs: True)
    found = adjust(block, **options)
    damping = np.asarray(found.iterations.history.damping)[: int(found.iterations.trials)]
    assert found.status is Status.CONVERGED and damping[0] > 0 and (damping[1:] == 0).all()
    assert float(found.vtpv) == pytest.approx(float(expected.vtpv), rel=1e-10)
    np.testing.assert_allclose(found.block.object_points, expected.block.object_points, rtol=0, atol=1e-6)
    assert adjust(block, max_iterations=1, **options).status is Status.CREEPING


def test_an_undetermined_rotation_about_control_is_told_with_its_line():
    """What neither moves nor is moved: two control points, far from the origin of the object system."""
    block, known = free_network(), np.array([[5000.0, 700.0, 20.0], [5800.0, 700.0, 20.0]])
    group = observation_group(CONTROL, np.arange(2)[:, None], known, np.full(known.shape, 0.05))
    points = block.object_points.at[:2].set(known)
    block = dataclasses.replace(eqx.tree_at(lambda b: b.object_points, block, points), groups=(group,))
    frame, whole = frame_of(block), datum_defect(block).directions
    (found,) = gauge_findings(block, Gauge(whole, (whole,), (), frame.centre, frame.radius))
    names = block.structure.point_names[:2]
    assert f"the rotation about the line through {names[0]}, {names[1]}" in found.what
    assert [subject.names[0] for subject in found.subjects] == list(names)
