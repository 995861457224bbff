"""Subsets of the observations hold what their names say."""

import dataclasses

import numpy as np
import pytest
from cases.all_observations import CASES, strip

from jaxbundle.block.block import Block
from jaxbundle.statistics.subsets import (
    XY,
    Z,
    all_control,
    all_observations,
    camera_rays,
    control_point,
    control_rays,
    default_groups,
    image_coordinates,
    image_rays,
    is_control_point,
    observations_of_kind,
    observed_points,
    tie_rays,
)


@pytest.fixture(scope="module")
def block() -> Block:
    """Weighted control, distances, angles, and parameters."""
    return CASES["geodetic"](strip())


def test_default_groups_are_everything(block):
    groups = default_groups(block)
    assert [g.name for g in groups[:3]] == ["rays of control points", "rays of tie points", "control"]
    assert sum(group.count for group in groups) == all_observations(block).count == block.n_observations
    together = groups[0]
    for group in groups[1:]:
        assert (together & group).count == 0
        together = together | group
    assert together.count == block.n_observations
    assert (control_rays(block) | tie_rays(block)).count == image_coordinates(block).count


def test_control_points(block):
    points = block.groups[0].structure.indices[:, 0]
    assert observed_points(block) == tuple(block.structure.point_names[p] for p in points)
    assert set(np.flatnonzero(is_control_point(block))) == set(points)
    assert control_rays(block).count == 2 * np.isin(block.structure.ray_point, points).sum()
    one = control_point(block, block.structure.point_names[points[1]])
    assert one.count == 3 and one.masks[1][1].all()
    held = block.structure.point_free.copy()
    held[np.setdiff1d(np.arange(len(held)), points)[0], 2] = False
    with_held = dataclasses.replace(block, structure=dataclasses.replace(block.structure, point_free=held))
    assert is_control_point(with_held).sum() == len(points) + 1


def test_cameras_and_images(block):
    assert camera_rays(block, "camera").count == image_coordinates(block).count
    names = block.structure.image_names
    first = image_rays(block, names[:1], "first photo")
    assert first.name == "first photo" and first.count == 2 * (block.structure.ray_image == 0).sum()
    met = control_rays(block) & first
    assert 0 < met.count < first.count and met.name == "rays of control points, first photo"
    assert met.named("new").name == "new"


def test_kinds_and_components(block):
    control = observations_of_kind(block, "control")
    plan, heights = observations_of_kind(block, "control", XY), observations_of_kind(block, "control", Z)
    assert plan.count == 2 * heights.count and (plan | heights).count == control.count
    assert plan.name == "X, Y of control"
    distances = observations_of_kind(block, "distances")  # between points, and from a centre
    assert distances.count == 3
    assert all_control(block).count == block.n_observations - image_coordinates(block).count


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda block: camera_rays(block, "left"), "no camera 'left'"),
        (lambda block: image_rays(block, ["7_7"], "strip 7"), "no image '7_7'"),
        (lambda block: control_point(block, "none"), "no point 'none'"),
        (lambda block: control_point(block, block.structure.point_names[-1]), "has no observed coordinates"),
        (lambda block: observations_of_kind(block, "stations"), "no observations 'stations'; there are control,"),
        (
            lambda block: observations_of_kind(block, "control", ["H"]),
            "control has no component 'H'; there are X, Y, Z",
        ),
    ],
)
def test_unknown_names(block, ask, words):
    with pytest.raises(ValueError, match=words):
        ask(block)
