"""Flights: what is flown where, where control stands, and what is refused."""

import dataclasses
import math

import numpy as np
import pytest

from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.planning.flight import (
    AerialCamera,
    ControlSet,
    FlightPlan,
    GrossErrors,
    Navigation,
    Terrain,
    Ties,
    plan_problems,
    schematic,
)
from jaxbundle.planning.ground import ground_points, inside
from jaxbundle.planning.lines import frame_of, stations_of
from jaxbundle.planning.simulation import simulate_flight
from jaxbundle.planning.terrain import grid_heights, slope, waves

AREA = ((0.0, 0.0), (6000.0, 500.0), (5000.0, 4000.0), (-500.0, 3500.0))


def points_of(plan):
    frame = frame_of(plan)
    return ground_points(plan, frame, stations_of(plan, frame), np.random.default_rng(0))


def test_schematic_flight_stands_at_equal_distances():
    plan = schematic(strips=3, images=5)
    frame = frame_of(plan)
    stations = stations_of(plan, frame)
    assert (frame.base, frame.strip_distance) == pytest.approx((901.96, 1803.92), abs=0.01)
    assert stations.xy[:6, 0] == pytest.approx([0, 901.96, 1803.92, 2705.88, 3607.84, 0], abs=0.01)
    assert not stations.kappa.any()
    xy = points_of(plan).xy
    assert len(xy) == 5 * 7 and xy[:, 1].min() == pytest.approx(-frame.strip_distance / 2)


def test_cross_strips_cross_all_strips():
    plan = schematic(strips=2, images=5, cross_strips=(0.0, 1.0))
    stations = stations_of(plan, frame_of(plan))
    assert stations.crossing.tolist() == [0, 0, 1, 1]
    cross = stations.xy[stations.strip == 2]
    assert np.allclose(cross[:, 0], 0) and len(cross) == 5
    assert np.allclose(stations.kappa[stations.strip >= 2], math.pi / 2)
    assert stations.names[-1] == "4_05"


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi / 2])
def test_area_is_covered_by_two_images_of_a_strip(heading):
    plan = FlightPlan(area=AREA, headings=(heading,), forward_overlap=0.6, side_overlap=0.2, scatter=0.0, tilt=0.0)
    frame = frame_of(plan)
    stations = stations_of(plan, frame)
    places = np.random.default_rng(1).uniform(-500, 6000, (4000, 2))
    places = frame.to_local(places[inside(np.asarray(AREA), places)])
    off = np.abs(places[:, None] - stations.xy)
    seen = (off <= np.array(frame.footprint) / 2 + 1e-6).all(2)
    assert seen.sum(1).min() >= 2


def test_second_heading_is_flown_across():
    plan = FlightPlan(area=AREA, headings=(math.pi / 2, 0.0))
    crossing = stations_of(plan, frame_of(plan)).crossing
    assert set(crossing.tolist()) == {0, 1}


def test_control_layouts_in_a_rectangle():
    plan = schematic(strips=2, images=9)
    for control, count in (
        (ControlSet("corners"), 4),
        (ControlSet("perimeter", count=3), 8),
        (ControlSet("grid", count=3), 9),
        (ControlSet("rows", count=2), 6),
        (ControlSet("chains", every=4), 9),
        (ControlSet("points", points=((0.0, 0.0), (900.0, 10.0))), 2),
    ):
        known = points_of(dataclasses.replace(plan, control=(control,))).sigmas
        assert np.isfinite(known).any(1).sum() == count, control


def test_control_sets_at_the_same_place_are_one_point():
    sets = ControlSet("corners", "plan", (0.02, 0.02, 0.05)), ControlSet("corners", "height", (0.02, 0.02, 0.05))
    known = points_of(schematic(strips=2, images=9, control=sets)).sigmas
    assert known[np.isfinite(known).any(1)].tolist() == [[0.02, 0.02, 0.05]] * 4


def test_control_of_an_area_stands_in_it():
    frame = frame_of(FlightPlan(area=AREA))
    assert frame.origin == AREA[0]
    sets = ControlSet("corners"), ControlSet("grid", count=4), ControlSet("perimeter", count=12)
    found = points_of(FlightPlan(area=AREA, control=sets))
    control = found.xy[np.isfinite(found.sigmas).any(1)]
    assert np.allclose(control[:4], AREA)
    middle = np.mean(AREA, 0)
    assert inside(np.asarray(AREA), middle + (control - middle) * 0.999).all()


def test_terrains():
    x, y = np.array([0.0, 25.0, 100.0]), np.array([0.0, 25.0, 40.0])
    assert waves(10.0, 100.0)(x, y) == pytest.approx([0, 5, 0], abs=1e-12)
    assert slope(0.1, 0.0)(x, y) == pytest.approx([0, 2.5, 10])
    nodes = np.array([(a, b, a + 2 * b) for a in (0, 50) for b in (0, 50)], float)
    assert grid_heights(nodes)(x, y) == pytest.approx([0, 75, 130])
    with pytest.raises(ValueError, match="3 heights on 2 values of X and 2 of Y are not a grid"):
        grid_heights(nodes[:3])


def test_all_that_is_wrong_with_a_flight_is_told_at_once():
    plan = FlightPlan(
        strips=0,
        height=-1.0,
        forward_overlap=0.3,
        camera=AerialCamera(estimate=("f",)),
        ties=Ties("star"),
        control=(ControlSet("ring", "half"),),
        gnss=Navigation((0.0, 1.0, 1.0), "day"),
        gross_errors=GrossErrors(0.7),
        area=((0.0, 0.0),),
        cross_strips=(2.0,),
    )
    assert len(plan_problems(plan)) == 12
    with pytest.raises(ValueError, match="12 problems in the block"):
        simulate_flight(plan)


@pytest.fixture(scope="module")
def flown():
    """A small flight with everything."""
    return simulate_flight(
        FlightPlan(
            2,
            4,
            tilt=0.02,
            headings=(1.0,),
            terrain=Terrain(20.0, slope(0.02, 0.0)),
            ties=Ties("grid", 12),
            control=(ControlSet("corners", sigmas=(0.02, 0.02, 0.0)),),
            check_points=2,
            gnss=Navigation((0.05, 0.05, 0.1), "strip", 0.3, 0.01, (0.1, 0.0, 0.2)),
            ins=Navigation((1e-4,) * 3, "block", 1e-3, offset=(0.01, 0.0, 0.0), offset_unknown=True),
            gross_errors=GrossErrors(0.02, 30.0),
            seed=5,
        )
    )


def test_gross_errors_are_where_they_are_said_to_be(flown):
    block, truth, gross = flown
    off = np.abs(np.asarray(block.rays.coordinates - truth.rays.coordinates)) / 0.005
    assert len(gross) == round(0.02 * len(off)) and (off[gross].max(1) > 20).all()
    assert np.delete(off, gross, 0).max() < 6


def test_navigation_of_a_flight(flown):
    block, truth, _ = flown
    kinds = [group.structure.kind for group in block.groups]
    assert kinds == [CONTROL, GNSS_STATIONS, ATTITUDES["omega-phi-kappa"]]
    assert not np.asarray(block.parameters)[block.structure.parameter_free].any()
    named = dict(zip((p.name for p in truth.structure.parameters), np.asarray(truth.parameters), strict=True))
    assert named["lever_arm Z of strip 2"] == 0.2 and 0 < abs(named["shift X of strip 1"]) < 1.5
    assert named["boresight omega of flight"] == 0.01
    observed = np.asarray(truth.groups[1].values) - np.asarray(truth.exterior.projection_centre)
    assert np.abs(observed).max() > 0.1
    assert np.abs(np.asarray(truth.groups[1].constants).sum()) < 1e-9  # times count from the middle of each strip
    assert (~truth.structure.point_free).sum() == 4


def test_listed_points_off_all_images_are_told():
    plan = FlightPlan(1, 3, ties=Ties("grid", 12), control=(ControlSet("points", points=((1e5, 0.0),)),))
    with pytest.raises(ValueError, match="1 points of the lists of control and check points are on no image"):
        simulate_flight(plan)
