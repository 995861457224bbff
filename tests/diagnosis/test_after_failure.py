"""What keeps a block from converging is named, with the size of its error."""

import equinox as eqx
import numpy as np
import pytest
from cases.gross_errors import strip

import jaxbundle as jb
from jaxbundle.block.block import Block
from jaxbundle.block.findings import Kind, Subject
from jaxbundle.diagnosis.after_failure import causes
from jaxbundle.diagnosis.wrong_rays import _control, _whole_control


@pytest.fixture(scope="module")
def cured(shared_data) -> Block:
    return jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / "cured", check_start=False)


def with_error(block: Block, member: int, axis: int, error: float) -> Block:
    """A control coordinate that is wrong, and the approximate one with it."""
    group = block.groups[0]
    point = int(group.structure.indices[member, 0])
    return eqx.tree_at(
        lambda b: (b.groups[0].values, b.object_points),
        block,
        (group.values.at[member, axis].add(error), block.object_points.at[point, axis].add(error)),
    )


def test_nothing_is_said_where_the_adjustment_ended_well(cured):
    assert causes(cured, jb.adjust(cured, precision=False)) == ()


@pytest.mark.parametrize(("axis", "error"), [(0, 30.0), (0, 1000.0), (2, 100.0)])
def test_a_wrong_control_coordinate(cured, axis, error):
    block = with_error(cured, 2, axis, error)
    (found,) = causes(block, jb.adjust(block, precision=False, max_iterations=40))
    name = block.structure.point_names[block.groups[0].structure.indices[2, 0]]
    assert found.kind is Kind.SUSPECT
    assert found.subjects == (Subject("control", (name,)),)
    assert found.size == pytest.approx(error, abs=0.2)
    assert found.unit == "m"


def test_exchanged_names(shared_data):
    block = jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / "pair", check_start=False)
    (found,) = causes(block, jb.adjust(block, precision=False, max_iterations=40))
    assert {subject.names[0] for subject in found.subjects} == {"GCP1", "GCP2"}
    assert found.size == pytest.approx(105, abs=0.5)


@pytest.mark.thorough
@pytest.mark.parametrize("case", ["weighted", "fixed"])
def test_exchanged_axes(shared_data, case):
    block = jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / case, check_start=False)
    (found,) = causes(block, jb.adjust(block, precision=False, max_iterations=40))
    assert found.subjects == (Subject("control", ("GCP3",)),)


def test_extreme_sigmas(cured):
    sigmas = cured.rays.sigmas.at[4].set(1e-6), cured.groups[0].sigmas.at[1].set(1e-7)
    block = eqx.tree_at(lambda b: (b.rays.sigmas, b.groups[0].sigmas), cured, sigmas)
    found = causes(block, jb.adjust(block, precision=False, max_iterations=1))
    s = block.structure
    ray = s.image_names[s.ray_image[4]], s.point_names[s.ray_point[4]]
    point = s.point_names[block.groups[0].structure.indices[1, 0]]
    assert [(f.kind, f.subjects) for f in found[:2]] == [
        (Kind.SIGMAS, (Subject("rays", ray),)),
        (Kind.SIGMAS, (Subject("control", (point,)),)),
    ]
    assert np.isfinite(found[0].size)


def test_a_control_point_that_contradicts_all_its_rays_is_told_from_a_ray():
    """Point 8 of the strip has one ray, point 7 two: coordinates and only ray cannot be told apart."""
    block = strip()
    s = block.structure
    of_point = {name: np.flatnonzero(s.ray_point == s.point_names.index(name)) for name in ("7", "8")}
    assert [len(rays) for rays in of_point.values()] == [2, 1]
    tie = np.flatnonzero(s.point_free[s.ray_point].all(1))[:1]
    points, others = _whole_control(block, np.concatenate([of_point["8"], of_point["7"][:1], tie]))
    assert [s.point_names[p] for p in points] == ["8"]
    np.testing.assert_array_equal(others, np.concatenate([of_point["7"][:1], tie]))
    both = [(subject.table, subject.names) for subject in _control(block, points[0], "").subjects]
    assert both == [("control", ("8",)), ("rays", ("1_05", "8"))]
