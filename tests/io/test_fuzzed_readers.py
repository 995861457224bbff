"""Blocks in files made wrong at random, and those that once ended badly: a Block, or a BlockError in words."""

import os
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.bal_file import TINY
from cases.mutated_files import bal_mutated, folder_mutated, put
from cases.small_folder import POINTS, change, make_small_folder, write
from hypothesis import HealthCheck, given, settings, strategies as st

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError, is_hidden
from jaxbundle.io import block_folder, read, read_bal

INPUTS = 80
EVERYTHING = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])

# folder: the beginning of the one line, and words in it
CASES = {
    "fail-Error-tables.py-140": ("control.csv:1: ", "are missing"),
    "fail-Hang-tables.py-39": ("images.csv: ", "the table has no rows"),
    "fail-IndexError-folder_tables.py-168": ("rays.csv: ", "the table has no rows"),
    "fail-LinAlgError-control_columns.py-35": ("control.csv:4: ", "sX is '1e308', larger than 1e+12"),
    "fail-LinAlgError-observations.py-79": ("control.csv:4: ", "cYZ is '1e308', larger than 1e+24"),
    "fail-OSError-tables.py-115": ("aaaa", "File name too long"),
    "fail-TypeError-block_toml.py-103": ("block.toml:7: ", "[units] angle is \"07:32:00\"; give 'deg'"),
    "sus-huge-angles": ("images.csv:5: ", "kappa is '-1e308', larger than 36000"),
    "sus-huge-azimuths": ("azimuths.csv:3: ", "azimuth is '1e308'"),
    "sus-huge-azimuths.sig": ("azimuths.csv:3: ", "sigma is '1e308'"),
    "sus-huge-centre": ("images.csv:4: ", "X0 is '-1e308'"),
    "sus-huge-control": ("control.csv:5: ", "(301 characters)"),
    "sus-huge-control.sig": ("control.csv:4: ", "(301 characters)"),
    "sus-huge-directions": ("directions.csv:4: ", "direction is '1e308'"),
    "sus-huge-directions.sig": ("directions.csv:4: ", "sigma is '1e308'"),
    "sus-huge-horizontal_distances": ("horizontal_distances.csv:3: ", "distance is '1e308'"),
    "sus-huge-horizontal_distances.sig": ("horizontal_distances.csv:3: ", "sigma is '1e308'"),
    "sus-huge-interior": ("block.toml:17: ", "principal_distance is 1e+308, not from 1e-06 to 1e+09"),
    "sus-huge-parameters.sig": ("bars.csv:4: ", "sigma is '1e308'"),
    "sus-huge-rays": ("rays.csv:9: ", "x is '-1e308'"),
    "sus-huge-scale_bars.sig": ("scale_bars.csv:4: ", "sigma is '1e308'"),
    "sus-huge-sig": ("rays.csv:43: ", "sy is '1"),
    "sus-huge-points/input.txt": ("input.txt:", "as a coordinate is"),
    "sus-nonfinite-angles/input.txt": ("input.txt:22: ", "1e+308 is not from 0 to 628.319"),
    "sus-nonfinite-centre/input.txt": ("input.txt:22: ", "1e+308 is not from 0 to 628.319"),
    "solve/approx-centre-1e300": ("images.csv:2: ", "larger than 1e+12"),
    "solve/principal-distance-1e-12-noprec": ("block.toml:11: ", "principal_distance is 1e-12"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_once_ended_badly(shared_data: Path, name: str) -> None:
    begin, words = CASES[name]
    with pytest.raises(BlockError) as caught:
        read(shared_data / "cases" / "fuzz" / name)
    (line,) = caught.value.lines
    assert line.startswith(begin) and words in line, line


@pytest.mark.parametrize("file", ["dup.txt", "ladybug-dup.txt"])
def test_bal_point_measured_again(shared_data: Path, file: str) -> None:
    """Both rays are observations; one finding names image and point."""
    path = shared_data / "cases" / "fuzz" / "bal-duplicate" / file
    block = read(path)
    (finding,) = block.structure.findings
    assert finding.subjects[0].names == ("0", "0")
    assert len(block.structure.ray_point) == int(path.read_text().split(None, 3)[2])


@pytest.fixture
def without_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither forward intersection nor the test of the datum, whose programs depend on the number of points."""

    def any_for_missing(block: Block) -> Block:
        points = np.asarray(block.object_points)
        points = np.where(np.isnan(points), np.random.default_rng(0).normal(0, 10, points.shape), points)
        return eqx.tree_at(lambda b: b.object_points, block, jnp.asarray(points))

    monkeypatch.setattr(block_folder, "intersect", any_for_missing)
    monkeypatch.setattr(block_folder, "validate", block_folder.weaknesses)


def assert_block_or_words(path: Path) -> None:
    try:
        block = read(path)
    except BlockError as error:
        assert error.lines
        assert not any(is_hidden(c) for line in error.lines for c in line)
        return
    values = block.exterior.projection_centre, block.exterior.angles, block.interior.elements, block.rays.sigmas
    assert all(np.isfinite(np.asarray(value)).all() for value in values)


def test_mutated_folders(without_compiling: None, tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    for number in range(INPUTS):
        put(folder, folder_mutated(files, np.random.default_rng([3, number])))
        assert_block_or_words(folder)
        put(folder, dict(files))


def test_mutated_bal_files(tmp_path: Path) -> None:
    path = tmp_path / "tiny.txt"
    for number in range(INPUTS):
        path.write_bytes(bal_mutated(TINY.encode(), np.random.default_rng([4, number])))
        assert_block_or_words(path)


@EVERYTHING
@given(data=st.binary(max_size=300))
def test_any_bytes_as_a_table(without_compiling: None, tmp_path: Path, data: bytes) -> None:
    folder = tmp_path / "small"
    if not folder.exists():
        make_small_folder(folder)
    (folder / "points.csv").write_bytes(data)
    assert_block_or_words(folder)


@EVERYTHING
@given(text=st.text(max_size=200))
def test_any_text_as_block_toml(tmp_path: Path, text: str) -> None:
    folder = tmp_path / "small"
    if not folder.exists():
        make_small_folder(folder)
    (folder / "block.toml").write_text(text, encoding="utf-8")
    assert_block_or_words(folder)


@EVERYTHING
@given(data=st.binary(max_size=300))
def test_any_bytes_as_a_file(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "block.txt"
    path.write_bytes(data)
    assert_block_or_words(path)


# what is smaller than a coordinate can be is refused
COORDINATE = st.floats(-1e6, 1e6).map(lambda x: x if abs(x) > 1e-6 else 0.0)
COORDINATES = st.tuples(COORDINATE, COORDINATE, COORDINATE)


@EVERYTHING
@given(points=st.lists(COORDINATES, min_size=8, max_size=8))
def test_any_coordinates_in_a_table(without_compiling: None, tmp_path: Path, points: list[tuple]) -> None:
    """Every number is read to its last bit."""
    folder = make_small_folder(tmp_path / "small")
    rows = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(POINTS, points, strict=False)]
    write(folder, "points.csv", "point,X,Y,Z", rows)
    block = read(folder, check_start=False)
    index = [block.structure.point_names.index(name) for name in POINTS[5:8]]  # those before them have control
    np.testing.assert_array_equal(np.asarray(block.object_points)[index], points[5:])


@EVERYTHING
@given(distance=st.floats(1.0, 1e4), sigma=st.floats(1e-3, 1e3))
def test_any_values_in_block_toml(without_compiling: None, tmp_path: Path, distance: float, sigma: float) -> None:
    folder = make_small_folder(tmp_path / "small")
    change(folder, "block.toml", 17, "50.0", repr(distance))
    change(folder, "block.toml", 23, "0.5", repr(sigma))
    block = read(folder, check_start=False)
    assert float(block.interior.elements[0, 0]) == distance
    np.testing.assert_array_equal(block.rays.sigmas, sigma)


@EVERYTHING
@given(points=st.tuples(COORDINATES, COORDINATES), distance=st.floats(1.0, 1e4))
def test_any_numbers_in_a_bal_file(tmp_path: Path, points: tuple, distance: float) -> None:
    begin = TINY.partition("\n1500\n")[0].replace("1400", repr(distance))
    numbers = [repr(number) for point in points for number in point]
    path = tmp_path / "tiny.txt"
    path.write_text("\n".join([begin, "1500", "0", "0", *numbers]) + "\n")
    block = read_bal(path)
    np.testing.assert_array_equal(block.object_points, points)
    assert float(block.interior.elements[0, 0]) == distance


def test_what_is_no_file(tmp_path: Path) -> None:
    """Pipes, devices, folders, loops and files of /proc in the place of a table or of the whole block."""
    folder = make_small_folder(tmp_path / "small")
    os.mkfifo(tmp_path / "pipe")
    for target in (tmp_path / "pipe", Path("/dev/zero"), Path("/proc/self/mem"), tmp_path, folder / "points.csv"):
        with pytest.raises(
            BlockError, match="regular file|has an unknown format|has no block.toml|does not exist|Too many"
        ):
            read(target if target.name != "points.csv" else tmp_path / "nowhere")
        (folder / "points.csv").unlink()
        (folder / "points.csv").symlink_to(target)
        with pytest.raises(BlockError) as caught:
            read(folder)
        (line,) = caught.value.lines
        assert line.startswith("points.csv: the file ")


def test_a_file_larger_than_memory(tmp_path: Path) -> None:
    """A file of 8 TiB that holds nothing is refused before it is read."""
    folder = make_small_folder(tmp_path / "small")
    with (folder / "points.csv").open("r+b") as file:
        file.truncate(2**43)
    with pytest.raises(BlockError, match="points.csv: the file has 8192.0 GiB; reading it needs about 81920 GiB"):
        read(folder)
    with (tmp_path / "bal.txt").open("wb") as file:
        file.write(b"1 1 1\n")
        file.truncate(2**43)
    with pytest.raises(BlockError, match="bal.txt has 8192.0 GiB"):
        read_bal(tmp_path / "bal.txt")
