"""The datum: how much of it observations determine, and what is held where they determine nothing."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.free_networks import free_network

from jaxbundle.block.block import Block, Datum, Parameter
from jaxbundle.block.datum import with_datum
from jaxbundle.block.datum_defect import datum_defect
from jaxbundle.block.geodetic import DISTANCES, geodetic_kind
from jaxbundle.block.navigation import GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, ObservationGroup, observation_group
from jaxbundle.block.problems import BlockError
from jaxbundle.solve.adjust import adjust

NO = np.nan


def control(*coordinates: tuple[float, float, float]) -> ObservationGroup:
    """Control coordinates of the first points of the block; NaN where one is not known."""
    values = np.array(coordinates, float)
    return observation_group(CONTROL, np.arange(len(values))[:, None], values, np.full(values.shape, 0.05))


def placed(block: Block, group: ObservationGroup) -> Block:
    """The block with control whose approximate coordinates are the known ones, where these are known."""
    known = jnp.where(jnp.asarray(group.structure.observed), group.values, block.object_points[: len(group.values)])
    points = block.object_points.at[: len(known)].set(known)
    return dataclasses.replace(eqx.tree_at(lambda b: b.object_points, block, points), groups=(*block.groups, group))


def with_stations(block: Block) -> Block:
    """The block with observed projection centres, every strip exactly straight along X."""
    names = block.structure.image_names
    nominal = np.array([[600.0 * int(name[2:]), 1000.0 * int(name[0]), 1500.0] for name in names])
    group = observation_group(STATIONS, np.arange(len(names))[:, None], nominal, np.full(nominal.shape, 0.1))
    block = eqx.tree_at(lambda b: b.exterior.projection_centre, block, jnp.asarray(nominal))
    return dataclasses.replace(block, groups=(group,))


@pytest.mark.parametrize(
    ("known", "count", "words"),
    [
        ([], 7, "origin, axes and scale"),
        ([(0, 0, 0)], 4, "all three rotations, the scale"),
        ([(0, 0, 0), (800, 0, 0)], 1, "the rotation about an axis parallel to X"),
        ([(0, 0, 0), (300, 400, 0)], 1, "the rotation about an axis parallel to (0.60, 0.80, 0.00)"),
        ([(0, 0, 0), (800, 0, 0), (NO, NO, 20)], 0, ""),
        ([(0, 0, 0), (800, 0, 0), (400, 500, 0)], 0, ""),
        ([(0, 0, NO), (800, 0, NO)], 3, "the position along Z, two of the three rotations"),
        ([(0, 0, 0), (NO, NO, 0), (NO, NO, 0)], 2, "the rotation about an axis parallel to Z, the scale"),
    ],
)
def test_control(known, count, words):
    block = free_network()
    defect = datum_defect(placed(block, control(*known)) if known else block)
    assert defect.count == count
    assert defect.words == words


def test_heights_alone_leave_plane_position_azimuth_and_scale():
    block = placed(free_network(), control((NO, NO, 0.0), (NO, NO, 10.0), (NO, NO, 20.0)))
    assert datum_defect(block).count == 4


def test_a_table_without_observations_gives_nothing():
    nothing = observation_group(DISTANCES, np.zeros((0, 2), int), np.zeros((0, 1)), np.zeros((0, 1)))
    block = placed(free_network(), control((0, 0, 0), (800, 0, 0), (400, 500, 0)))
    assert datum_defect(dataclasses.replace(block, groups=(*block.groups, nothing))).count == 0
    found = adjust(dataclasses.replace(block, groups=(nothing, *block.groups)), precision=False)
    assert float(found.vtpv) == pytest.approx(float(adjust(block, precision=False).vtpv), rel=1e-9)


def test_distance_gives_the_scale():
    block = free_network()
    distance = observation_group(DISTANCES, np.array([[0, 5]]), np.array([[400.0]]), np.array([[0.01]]))
    defect = datum_defect(dataclasses.replace(block, groups=(distance,)))
    assert (defect.count, defect.words) == (6, "the origin, all three rotations")


def test_strip_with_observed_stations_rolls_about_its_line():
    strip = with_stations(free_network())
    defect = datum_defect(strip)
    assert (defect.count, defect.words) == (1, "the rotation about an axis parallel to X")
    assert datum_defect(placed(strip, control((NO, NO, 15.0)))).count == 0
    assert datum_defect(with_stations(free_network(2))).count == 0


def test_the_datum_is_judged_where_it_was_observed():
    """Not where it is approximately: approximate values on a line or at one place hide nothing and refuse nothing."""
    strip = with_stations(free_network())
    beside = eqx.tree_at(lambda b: b.groups[0].values, strip, strip.groups[0].values.at[1, 1].add(2.0))
    assert datum_defect(beside).count == 0
    rough = eqx.tree_at(
        lambda b: b.exterior.projection_centre, strip, strip.exterior.projection_centre.at[1, 1].add(2.0)
    )
    defect = datum_defect(rough)
    assert (defect.count, defect.similarity.axes, defect.scale) == (1, ((1.0, 0.0, 0.0),), False)
    assert defect.fixed == strip.structure.image_names
    spread = placed(free_network(), control((0, 0, 0), (800, 0, 0), (400, 500, 0)))
    for value in (0.0, 1e30):
        wild = eqx.tree_at(lambda b: b.object_points, spread, jnp.full_like(spread.object_points, value))
        assert datum_defect(wild).count == 0


def test_a_large_origin_changes_nothing():
    block = placed(free_network(), control((0, 0, 0), (800, 0, 0)))
    moved = block.moved(jnp.array([5e5, 5e6, 1e3]))
    assert datum_defect(moved) == datum_defect(block)


def test_minimal_datum_is_chosen_and_named():
    """All of the first image, and the coordinate of another image that differs most from the first one's."""
    block = free_network()
    structure = with_datum(block).structure
    assert structure.datum == Datum(
        "minimal", (*(("1_01", name) for name in ("X0", "Y0", "Z0", "omega", "phi", "kappa")), ("1_03", "X0"))
    )
    assert "image 1_01: X0, Y0, Z0, omega, phi, kappa; image 1_03: X0" in str(structure.datum)
    assert structure.n_unknowns == block.structure.n_unknowns - 7
    assert not structure.exterior_free[0].any() and not structure.exterior_free[2, 0]
    assert datum_defect(with_datum(block)).count == 0
    again = with_datum(with_datum(block))
    assert again.structure.datum == structure.datum


def test_minimal_datum_leaves_the_scale_to_a_distance():
    block = free_network()
    distance = observation_group(DISTANCES, np.array([[0, 5]]), np.array([[400.0]]), np.array([[0.01]]))
    assert len(with_datum(dataclasses.replace(block, groups=(distance,))).structure.datum.held) == 6


def held(block: Block, *elements: tuple[str, str]) -> Block:
    """The block with these elements of its images held by the user."""
    structure = block.structure
    free = structure.exterior_free.copy()
    for image, element in elements:
        free[structure.image_names.index(image), structure.exterior_elements.index(element)] = False
    structure = dataclasses.replace(structure, exterior_free=free, datum=Datum("fixed", elements))
    return dataclasses.replace(block, structure=structure)


def test_every_minimal_datum_gives_the_same_residuals():
    """And the same sigma0; what is held keeps its value and has no standard deviation."""
    block = free_network()
    one = adjust(block)
    elements = (*(("1_02", name) for name in ("X0", "Y0", "Z0", "omega", "phi", "kappa")), ("1_01", "X0"))
    other = adjust(held(block, *elements))
    assert one.trustworthy and other.trustworthy
    assert float(one.sigma0) == pytest.approx(float(other.sigma0), rel=1e-10)
    np.testing.assert_allclose(one.residuals[0], other.residuals[0], rtol=0, atol=1e-9)  # mm
    for adjustment in (one, other):
        fixed = ~adjustment.block.structure.exterior_free
        exterior = [np.hstack([b.exterior.projection_centre, b.exterior.angles]) for b in (adjustment.block, block)]
        np.testing.assert_allclose(exterior[0][fixed], exterior[1][fixed], rtol=1e-13, atol=1e-13)
        sd = adjustment.standard_deviations
        assert not np.hstack([sd.projection_centre, sd.angles])[fixed].any()


def test_insufficient_control_is_refused():
    block = placed(free_network(), control((0, 0, 0), (800, 0, 0)))
    for refusing in (with_datum, adjust):
        with pytest.raises(BlockError, match="1 of the 7 parameters.*the rotation about an axis parallel to X"):
            refusing(block)


def test_datum_is_chosen_before_tracing():
    block = free_network()
    arrays, static = eqx.partition(block, eqx.is_array)
    with pytest.raises(ValueError, match="with_datum"):
        jax.jit(lambda arrays: adjust(eqx.combine(arrays, static)).sigma0)(arrays)


def with_navigation(block: Block, *sizes: str) -> Block:
    """The stations of a block with unknown shifts, or shifts and drifts, common to all ("block") or of every strip."""
    (stations,) = block.groups
    names = block.structure.image_names
    owners = ["block" if "block" in sizes else f"strip {name[0]}" for name in names]
    kinds = [size for size in ("shift", "drift") if size in sizes]
    owned = [f"{kind} {axis} of {who}" for who in dict.fromkeys(owners) for kind in kinds for axis in "XYZ"]
    parameters = (*(Parameter(name) for name in owned), *(Parameter(f"none {k}", free=False) for k in range(9)))
    number = {parameter.name: k for k, parameter in enumerate(parameters)}

    def chosen(kind: str, who: str, first: int) -> list[int]:
        return [number.get(f"{kind} {axis} of {who}", number[f"none {first + k}"]) for k, axis in enumerate("XYZ")]

    levers = [number[f"none {k}"] for k in range(3)]
    indices = [[i, *levers, *chosen("shift", w, 3), *chosen("drift", w, 6)] for i, w in enumerate(owners)]
    times = np.array([float(name[2:]) for name in names])[:, None]
    group = observation_group(
        GNSS_STATIONS, np.array(indices), np.asarray(stations.values), np.full((len(names), 3), 0.1), times
    )
    structure = dataclasses.replace(block.structure, parameters=parameters)
    return dataclasses.replace(block, structure=structure, groups=(group,), parameters=jnp.zeros(len(parameters)))


XYZ = (0.0, 0.0, 0.0), (800.0, 500.0, 10.0)


@pytest.mark.parametrize(
    ("sizes", "known", "count"),
    [
        (("shift", "block"), (), 3),
        (("shift",), (), 4),
        (("shift",), XYZ[:1], 1),
        (("shift",), XYZ, 0),
        (("shift", "drift"), (), 7),
        (("shift", "drift"), (*XYZ, (NO, NO, 20.0)), 0),
    ],
)
def test_navigation_data_with_systematic_errors(sizes, known, count):
    """Two parallel strips; the point that is known in height only lies off the line of the two others."""
    block = with_navigation(with_stations(free_network(2)), *sizes)
    defect = datum_defect(placed(block, control(*known)) if known else block)
    assert defect.count == count
    if count:
        assert any(name.startswith("shift") for name in defect.parameters)


def test_parameters_that_take_part_are_named_with_the_points_that_move():
    block = with_navigation(with_stations(free_network(2)), "shift")
    with pytest.raises(BlockError) as error:
        with_datum(placed(block, control(XYZ[0])))
    words = str(error.value)
    assert (
        "parameters involved: shift" in words
        and "points with the maximum displacements" in words
        and "fix the parameters" in words
    )


def with_height_differences(block: Block) -> Block:
    """The vertical and the scale from four levelled pairs of points."""
    points = np.asarray(block.object_points)
    seen = np.argsort(-np.bincount(block.structure.ray_point), kind="stable")
    pairs = np.array([[seen[k], seen[-1 - k]] for k in range(4)])
    differences = (points[pairs[:, 1], 2] - points[pairs[:, 0], 2] + [0.1, -0.2, 0.3, 0.1])[:, None]
    group = observation_group(geodetic_kind("height_differences"), pairs, differences, np.full((4, 1), 0.05))
    return dataclasses.replace(block, groups=(group,))


def holding(block: Block, image: int, elements: tuple[str, ...]) -> Block:
    """The block with elements of one image held."""
    structure, free = block.structure, block.structure.exterior_free.copy()
    for element in elements:
        free[image, structure.exterior_elements.index(element)] = False
    held = tuple((structure.image_names[image], element) for element in elements)
    structure = dataclasses.replace(structure, exterior_free=free, datum=Datum("fixed", held))
    return dataclasses.replace(block, structure=structure)


def test_minimal_datum_leaves_the_vertical_to_what_gives_it():
    """Position and azimuth are open, no more is held, and the result is that of any such datum."""
    block = with_height_differences(free_network(2))
    assert datum_defect(block).count == 4
    chosen = adjust(block)
    assert chosen.block.structure.datum == Datum(
        "minimal", tuple(("1_01", element) for element in ("X0", "Y0", "Z0", "kappa"))
    )
    other = adjust(holding(block, 4, ("X0", "Y0", "Z0", "kappa")))
    assert chosen.redundancy == other.redundancy
    np.testing.assert_allclose(chosen.vtpv, other.vtpv, rtol=1e-9)


def inner(block: Block) -> Block:
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, datum=Datum("inner")))


def test_inner_constraints_need_open_axes():
    with pytest.raises(BlockError, match="undetermined here: the origin, the rotation about .* to Z; leave"):
        with_datum(inner(with_height_differences(free_network(2))))


def with_parameter(block: Block, table: str, indices: list[list[int]]) -> Block:
    """Observations that touch an unknown of their own."""
    size = np.ones((len(indices), 1))
    group = observation_group(geodetic_kind(table), np.array(indices), 0 * size, 1e-3 * size)
    structure = dataclasses.replace(block.structure, parameters=(Parameter("own"),))
    block = dataclasses.replace(block, structure=structure, groups=(group,))
    return eqx.tree_at(lambda b: b.parameters, block, jnp.ones(1))


def test_parameters_that_move_with_the_datum():
    """Three directions give two angles; a bar of unknown length gives nothing, and its length moves with the scale."""
    directions = with_parameter(free_network(2), "directions", [[0, 5, 0], [0, 6, 0], [0, 7, 0]])
    assert datum_defect(directions).parameters == ("own",)
    assert len(with_datum(directions).structure.datum.held) == 5
    bar = with_parameter(free_network(2), "scale_bars", [[0, 5, 0]])
    assert len(with_datum(bar).structure.datum.held) == 7
    with pytest.raises(BlockError, match="axes of a free network are undetermined, and own change with them"):
        with_datum(inner(bar))
