"""Every table of the block folder: read as the same block built in Python, adjusted alike, written and read again."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from cases.same_block import assert_same, group_of, number
from cases.small_folder import append, change, make_small_folder, write
from cases.surveyed_site import BARS, CATEGORIES, GON, PAIRS, SCALE_BARS, SETS, STRIPS, make_surveyed_folder, truth

from jaxbundle.block.block import Block, Datum, Parameter
from jaxbundle.block.geodetic import ANGLES, LINES, PLANES, geodetic_kind
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import (
    CONTROL,
    PARAMETERS,
    STATIONS,
    interior_priors,
    observation_group,
)
from jaxbundle.io import read_block_folder, write_block_folder
from jaxbundle.solve.adjust import adjust


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_surveyed_folder(tmp_path_factory.mktemp("surveyed") / "site")


@pytest.fixture(scope="module")
def block(folder: Path) -> Block:
    return read_block_folder(folder)


# Reading


def test_observations_between_ends(folder: Path, block: Block) -> None:
    """Every value, sigma and end; ends are points of the images, theodolite stations or projection centres."""
    names = {"point": block.structure.point_names, "image": [f"image:{i}" for i in block.structure.image_names]}
    for table, (ends, sigma) in PAIRS.items():
        rows = pl.read_csv(folder / f"{table}.csv", infer_schema=False)
        unit = GON if table in ANGLES else 1.0
        found = {}
        for group in (group for group in block.groups if group.structure.kind.table == table):
            start, end = group.structure.kind.touches[:2]
            np.testing.assert_allclose(group.sigmas, sigma * unit, rtol=1e-15)
            for (i, j), value in zip(group.structure.indices.tolist(), np.asarray(group.values)[:, 0], strict=True):
                found[names[start][i], names[end][j]] = value / unit
        expected = dict(zip(ends, rows[:, 2].cast(pl.Float64), strict=True))
        assert found.keys() == expected.keys()
        assert all(found[key] == pytest.approx(expected[key], rel=1e-14) for key in expected)


def test_stations_on_no_image_take_part(block: Block) -> None:
    """In the order of points.csv, behind the points of the rays."""
    assert block.structure.point_names[-2:] == ("T2", "T1")
    np.testing.assert_allclose(block.object_points[-1], truth()["T1"], atol=0.5)
    assert block.structure.point_free[-2:].all() and max(block.structure.ray_point) == len(truth()) - 3


def test_orientations_of_sets(block: Block) -> None:
    for name, (_, orientation) in SETS.items():
        k = number(block, f"orientation of set {name}")
        assert block.structure.parameters[k] == Parameter(f"orientation of set {name}", "gon", angle=True)
        off = float(block.parameters[k]) / GON - orientation
        assert abs((off + 200) % 400 - 200) < 2


def test_scale_bars(block: Block) -> None:
    group = group_of(block, geodetic_kind("scale_bars"))
    numbers = [number(block, f"length of bar {bar}") for bar, _, _ in SCALE_BARS]
    np.testing.assert_array_equal(group.structure.indices[:, 2], numbers)
    assert not np.asarray(group.values).any()
    priors = group_of(block, PARAMETERS)
    observed = dict(zip(priors.structure.indices[:, 0].tolist(), np.asarray(priors.sigmas)[:, 0], strict=True))
    for bar, sigma in BARS.items():
        k = number(block, f"length of bar {bar}")
        assert block.structure.parameters[k].free == (sigma != 0)
        assert observed.get(k, 0.0) == (sigma if sigma > 0 else 0.0)


def test_figures(block: Block) -> None:
    """Plumb lines are observed from their first point; frames lie in the figures."""
    plumb = group_of(block, geodetic_kind("plumb_lines"))
    names = [[block.structure.point_names[p] for p in row] for row in plumb.structure.indices]
    assert names == [["P0", "P1"], ["P0", "P2"]]
    np.testing.assert_array_equal(plumb.sigmas, 0.005)
    for kind, axis in ((PLANES, [-0.3, 0.1, 1.0]), (LINES, [0.8, 0.6, 0.05])):
        group = group_of(block, kind)
        frame = np.asarray(group.constants)[0, 3:].reshape(3, 3)
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
        axis = np.array(axis) / np.linalg.norm(axis)
        assert abs(frame[:, 2] @ axis) > 0.999
        assert not np.asarray(block.parameters)[group.structure.indices[0, 1:]].any()


def test_navigation(block: Block) -> None:
    """Nine parameters a group; times from the mean of each group; what is of no group has no systematic errors."""
    gnss, attitudes = group_of(block, GNSS_STATIONS), group_of(block, ATTITUDES["omega-phi-kappa"])
    names = [block.structure.image_names[i] for i in gnss.structure.indices[:, 0]]
    assert names == [image for image in STRIPS if image != "022"]
    np.testing.assert_array_equal(gnss.constants[:, 0], [-2, 2, 0])
    assert group_of(block, STATIONS).structure.indices.tolist() == [[3]]
    shift, drift = number(block, "shift X of strip 2"), number(block, "drift Z of strip 2")
    assert block.structure.parameters[shift] == Parameter("shift X of strip 2", "m", free=False)
    assert block.structure.parameters[drift] == Parameter("drift Z of strip 2", "m/t")
    boresight = number(block, "boresight kappa of strip 1")
    assert float(block.parameters[boresight]) == pytest.approx(0.3 * GON)
    assert attitudes.structure.indices[0].tolist()[1:4] == [boresight - 2, boresight - 1, boresight]
    alone = attitudes.structure.indices[3, 1:]
    assert not any(block.structure.parameters[p].free for p in alone) and not np.asarray(block.parameters)[alone].any()
    priors = group_of(block, PARAMETERS)
    at = priors.structure.indices[:, 0].tolist().index(boresight)
    assert float(priors.sigmas[at, 0]) == pytest.approx(0.05 * GON)
    notes = [note.words for note in block.structure.findings]
    assert "times of navigation group strip 1 count from their mean, 5002" in notes


def test_covariances_of_control(block: Block) -> None:
    control = group_of(block, CONTROL)
    assert control.covariances is not None
    np.testing.assert_allclose(
        control.covariances[0], [[4e-4, 1e-4, -5e-5], [1e-4, 4e-4, 0], [-5e-5, 0, 9e-4]], rtol=1e-14
    )
    np.testing.assert_allclose(control.covariances[1], np.diag([4e-4, 4e-4, 9e-4]), rtol=1e-14)


def test_identification_is_added_to_the_rays(block: Block) -> None:
    sigmas = {name: set() for name in block.structure.point_names}
    for p, pair in zip(block.structure.ray_point, np.asarray(block.rays.sigmas), strict=True):
        sigmas[block.structure.point_names[p]].update(pair.tolist())
    assert sigmas["1"] == sigmas["16"] == {np.hypot(0.5, CATEGORIES["target"])}
    assert sigmas["4"] == sigmas["11"] == {np.hypot(0.5, CATEGORIES["map"])}
    assert sigmas["13"] == sigmas["8"] == {0.5}


def test_priors_of_interior_elements(block: Block) -> None:
    group = group_of(block, interior_priors(block.structure.cameras[0].model.elements))
    np.testing.assert_array_equal(group.structure.observed, [[True, False, False, False, False]])
    assert (float(group.values[0, 0]), float(group.sigmas[0, 0])) == (50.0, 0.02)


# Adjusting


GUESSES = {PLANES: (-0.3, 0.1, 9.0), LINES: (0.7, 0.1, -20.0, 5.0)}  # of the parameters in frames along X, Y, Z


def in_python(block: Block) -> Block:
    """The same block, its observations put together anew: other frames, other values of the orientations."""
    middle = np.asarray(block.object_points).mean(0)
    upright = {PLANES: np.eye(3), LINES: np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])}
    groups, parameters = [], np.array(block.parameters)
    for group in block.groups:
        structure = group.structure
        values, sigmas = (np.where(structure.observed, x, np.nan) for x in (group.values, group.sigmas))
        constants = np.asarray(group.constants)
        if structure.kind in upright:
            constants = np.tile(np.append(middle, upright[structure.kind]), (len(values), 1))
            parameters[structure.indices[0, 1:]] = GUESSES[structure.kind]
        if structure.kind.name == "directions":
            parameters[structure.indices[:, 2]] += 0.01
        covariances = None if group.covariances is None else np.asarray(group.covariances)
        groups.append(observation_group(structure.kind, structure.indices, values, sigmas, constants, covariances))
    return eqx.tree_at(lambda b: (b.groups, b.parameters), block, (tuple(groups), jnp.asarray(parameters)))


@pytest.fixture(scope="module")
def adjustment(block: Block):
    return adjust(block)


def test_everything_is_adjusted_together(block: Block, adjustment) -> None:
    """Errors were drawn with the sigmas given: sigma0 is near 1, and the truth is near."""
    assert adjustment.trustworthy
    assert 0.8 < float(adjustment.sigma0) < 1.2
    names = block.structure.point_names
    off = adjustment.block.object_points - jnp.array([truth()[name] for name in names])
    sd = adjustment.standard_deviations
    size = np.asarray(off / jnp.where(sd.object_points > 0, sd.object_points, 1.0))
    assert np.sqrt((size**2).mean()) < 1.5
    for name, value in (
        ("shift X of strip 1", 0.4),
        ("drift X of strip 2", 0.01),
        ("boresight phi of strip 1", -0.1 * GON),
    ):
        k = number(block, name)
        assert abs(float(adjustment.block.parameters[k]) - value) < 4 * float(sd.parameters[k])


def test_other_frames_give_the_same_result(block: Block, adjustment) -> None:
    other = adjust(in_python(block))
    assert float(other.sigma0) == pytest.approx(float(adjustment.sigma0), rel=1e-9)
    sd = np.asarray(adjustment.standard_deviations.object_points)
    off = np.asarray(other.block.object_points - adjustment.block.object_points)
    assert (np.abs(off) <= 1e-5 * sd + 1e-12).all()
    np.testing.assert_allclose(other.standard_deviations.object_points, sd, rtol=1e-6, atol=1e-12)
    kept = [
        k for k, p in enumerate(block.structure.parameters) if " of plane " not in p.name and " of line " not in p.name
    ]
    np.testing.assert_allclose(
        np.asarray(other.block.parameters)[kept], np.asarray(adjustment.block.parameters)[kept], rtol=1e-7, atol=1e-9
    )


# Writing


def test_written_and_read_again(block: Block, tmp_path: Path) -> None:
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_adjusted_block_is_written(block: Block, adjustment, tmp_path: Path) -> None:
    """Observations stay as they are; observed parameters go back to their observed values."""
    write_block_folder(adjustment.block, tmp_path / "again")
    again = read_block_folder(tmp_path / "again")
    np.testing.assert_allclose(again.object_points, adjustment.block.object_points, rtol=1e-15)
    for group, group_again in zip(block.groups, again.groups, strict=True):
        np.testing.assert_allclose(group.values, group_again.values, rtol=4e-15)
        np.testing.assert_allclose(group.sigmas, group_again.sigmas, rtol=4e-15)
    shift, free = number(block, "shift X of strip 1"), number(block, "length of bar free")
    for k in (shift, free):
        assert float(again.parameters[k]) == float(adjustment.block.parameters[k])


def test_free_network_is_written(tmp_path: Path) -> None:
    small = free_network(tmp_path, 'points = ["101", "104", "112"]')
    block = read_block_folder(small)
    assert block.structure.datum == Datum("inner", points=("101", "104", "112"))
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def free_network(tmp_path: Path, keys: str) -> Path:
    """The small folder without control."""
    small = make_small_folder(tmp_path / "small")
    change(small, "block.toml", 29, 'control = "control.csv"', "")
    (small / "control.csv").unlink()
    append(small, "block.toml", f'[datum]\ntype = "inner"\n{keys}')
    return small


@pytest.mark.parametrize("scale", [True, False])
def test_elements_of_a_free_network(tmp_path: Path, scale: bool) -> None:
    elements = '"translation", "rotation"' + (', "scale"' if scale else "")
    small = free_network(tmp_path, f"elements = [{elements}]")
    if not scale:
        change(small, "block.toml", 25, "[tables]", '[tables]\ndistances = "distances.csv"')
        write(small, "distances.csv", "from,to,distance,sigma", ["101,112,60,0.01"])
    assert read_block_folder(small).structure.datum == Datum("inner")
