import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.small_folder import (
    append,
    change,
    image_coordinates,
    make_small_folder,
    object_points,
    orientations,
    rotation,
    write,
    write_images,
)

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum import with_datum
from jaxbundle.block.findings import Kind, Severity
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, ObservationKind, observation_group
from jaxbundle.block.problems import BlockError
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA
from jaxbundle.io import read_block_folder, write_block_folder
from jaxbundle.io.block_toml import read_block_toml
from jaxbundle.io.noted import Noted

FOLDERS = (
    "strasbourg-s1-fixed",
    "strasbourg-s2-weighted",
    "strasbourg-s4-tie",
    "camcal-c1-fixed",
    "camcal-c2-weighted",
    "camcal-selfcal-3",
    "roma",
)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return make_small_folder(tmp_path / "small")


def assert_same(block: Block, again: Block, tolerance: float = 1e-15) -> None:
    """Equal structures and values; angles to rounding."""
    for field in dataclasses.fields(block.structure):
        if field.name != "notes":
            value, value_again = (getattr(structure, field.name) for structure in (block.structure, again.structure))
            assert np.array_equal(value, value_again) if isinstance(value, np.ndarray) else value == value_again, (
                field.name
            )
    np.testing.assert_allclose(block.exterior.angles, again.exterior.angles, rtol=tolerance)
    for values, values_again in (
        (block.exterior.projection_centre, again.exterior.projection_centre),
        (block.interior.elements, again.interior.elements),
        (block.object_points, again.object_points),
        (block.rays.coordinates, again.rays.coordinates),
        (block.rays.sigmas, again.rays.sigmas),
        (block.check_points.coordinates, again.check_points.coordinates),
        (block.check_points.sigmas, again.check_points.sigmas),
    ):
        np.testing.assert_array_equal(values, values_again)
    for group, group_again in zip(block.groups, again.groups, strict=True):
        assert group.structure.kind is group_again.structure.kind
        np.testing.assert_array_equal(group.structure.indices, group_again.structure.indices)
        np.testing.assert_array_equal(group.structure.observed, group_again.structure.observed)
        np.testing.assert_array_equal(group.values, group_again.values)
        np.testing.assert_array_equal(group.sigmas, group_again.sigmas)


@pytest.mark.parametrize("name", FOLDERS)
def test_real_blocks(shared_data: Path, tmp_path: Path, name: str) -> None:
    """Counts as expected, and the same block after writing and reading."""
    block = read_block_folder(shared_data / name)
    expected = json.loads((shared_data / name / "expected.json").read_text())
    assert block.n_observations == expected["observations"]
    assert block.structure.n_unknowns == expected["unknowns"]
    assert block.redundancy == expected["redundancy"]
    assert block.structure.name == name
    assert block.structure.findings == ()
    write_block_folder(block, tmp_path / name)
    assert_same(block, read_block_folder(tmp_path / name))


def test_small_block(small: Path) -> None:
    block = read_block_folder(small)
    structure = block.structure
    assert structure.image_names == ("011", "012", "021", "022")
    assert structure.point_names[:3] == ("101", "102", "103")
    assert block.n_observations == 2 * 48 + 3 + 2 + 1
    assert structure.n_unknowns == 4 * 6 + 11 * 3
    assert structure.datum == Datum("open")
    assert structure.cameras[0].principal_distance_in_mm and structure.cameras[0].width == 6000
    np.testing.assert_array_equal(block.interior.elements, [[50.0, 3010.0, 2490.0, 0.01, -1.0]])
    np.testing.assert_allclose(block.exterior.angles, np.radians(orientations()[:, 3:]), rtol=1e-15)
    np.testing.assert_array_equal(block.rays.coordinates, image_coordinates())
    np.testing.assert_array_equal(block.rays.sigmas, 0.5)


def test_control_of_every_sort(small: Path) -> None:
    block = read_block_folder(small)
    (control,) = block.groups
    assert control.structure.kind is CONTROL
    assert [block.structure.point_names[p] for p in control.structure.indices[:, 0]] == ["102", "103", "104"]
    np.testing.assert_array_equal(control.structure.observed, [[1, 1, 1], [1, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(control.sigmas[0], [0.02, 0.02, 0.04])
    np.testing.assert_array_equal(block.structure.point_free[:2], [[False] * 3, [True] * 3])
    np.testing.assert_array_equal(block.structure.check_point, [4])
    np.testing.assert_array_equal(block.check_points.coordinates[0], object_points()[4])
    assert np.isnan(block.check_points.sigmas).all()


def test_approximate_coordinates(small: Path) -> None:
    """Held control has its own; else those of points.csv, else of control.csv, else of the intersection."""
    change(small, "points.csv", 3, "102,-7.0,-16.0,1.8", "")
    change(small, "points.csv", 3, "103,8.0,-16.0", "103,8.5,")
    block = read_block_folder(small)
    points = object_points()
    np.testing.assert_array_equal(block.object_points[:2], points[:2])
    np.testing.assert_array_equal(block.object_points[2], [8.5, -16.0, -2.9])
    np.testing.assert_array_equal(block.object_points[5], np.round(points[5], 1))
    np.testing.assert_allclose(block.object_points[8:], points[8:], atol=1e-10)


@pytest.mark.parametrize(("unit", "half_turn"), [("deg", 180.0), ("gon", 200.0), ("rad", np.pi)])
def test_units_of_angles(small: Path, tmp_path: Path, unit: str, half_turn: float) -> None:
    change(small, "block.toml", 7, '"deg"', f'"{unit}"')
    write_images(small, orientations() * [1, 1, 1, *[half_turn / 180] * 3])
    block = read_block_folder(small)
    np.testing.assert_allclose(block.exterior.angles, np.radians(orientations()[:, 3:]), rtol=1e-15)
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_textbook_rotation_system(small: Path, tmp_path: Path) -> None:
    """alpha-omega-kappa: the same matrices give the same intersections."""
    change(small, "block.toml", 10, "omega-phi-kappa", "alpha-omega-kappa")
    matrices = tuple(jnp.stack([rotation(*angles) for angles in orientations()[:, 3:]]).reshape(-1, 9).T)
    angles = np.degrees(np.stack(ALPHA_OMEGA_KAPPA.angles_from_rotation(matrices), 1))
    write_images(small, np.c_[orientations()[:, :3], angles], "alpha,omega,kappa")
    block = read_block_folder(small)
    assert block.structure.rotation_system is ALPHA_OMEGA_KAPPA
    assert block.structure.exterior_elements == ("X0", "Y0", "Z0", "alpha", "omega", "kappa")
    np.testing.assert_allclose(block.object_points[8:], object_points()[8:], atol=1e-9)
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_camera_in_mm(small: Path) -> None:
    """The same rays in mm, y up from the principal point, give the same intersections."""
    change(small, "block.toml", 13, '"px"', '"mm"')
    change(small, "block.toml", 14, "pixel_size = 0.01", "")
    change(small, "block.toml", 17, "[3010.0, 2490.0]", "[0.1, -0.2]")
    x, y = (image_coordinates() - [3010.0, 2490.0]).T * 0.01
    lines = (small / "rays.csv").read_text().splitlines()[1:]
    names = [line.split(",")[:2] for line in lines]
    rows = [
        f"{image},{point},{a + 0.1!r},{-b - 0.2!r},,"
        for (image, point), a, b in zip(names, x.tolist(), y.tolist(), strict=True)
    ]
    write(small, "rays.csv", "image,point,x,y,sx,sy", rows)
    block = read_block_folder(small)
    np.testing.assert_array_equal(block.interior.elements, [[50.0, 0.1, -0.2, 1.0, 1.0]])
    assert not block.structure.cameras[0].principal_distance_in_mm
    np.testing.assert_allclose(block.object_points[8:], object_points()[8:], atol=1e-9)


BROWN_CAMERA = """
[cameras."second one"]
image_unit = "px"
principal_distance = 5000.0
principal_point = [3010.0, 2490.0]
distortion = "brown"
coefficients = { K1 = 1e-12, b2 = 1e-7 }
estimate = ["x0", "K1", "principal_distance"]
"""


def test_cameras_of_two_models(small: Path, tmp_path: Path) -> None:
    """Interior elements are in the order of each model and padded with ones."""
    append(small, "block.toml", BROWN_CAMERA)
    change(small, "images.csv", 3, "wide", "second one")
    block = read_block_folder(small)
    assert [camera.name for camera in block.structure.cameras] == ["wide", "second one"]
    np.testing.assert_array_equal(block.structure.image_camera, [0, 1, 0, 0])
    np.testing.assert_array_equal(
        block.interior.elements,
        [[50, 3010, 2490, 0.01, -1, *[1] * 7], [5000, 3010, 2490, 1e-12, 0, 0, 0, 0, 0, 1e-7, 1, -1]],
    )
    np.testing.assert_array_equal(np.nonzero(block.structure.interior_free), [[1, 1, 1], [0, 1, 3]])
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_stations_and_distances(small: Path, tmp_path: Path) -> None:
    append(small, "block.toml", 'stations = "gnss.csv"\ndistances = "distances.csv"')
    write(small, "gnss.csv", "image,X,Y,Z,sX,sY,sZ", ["021,-19.0,16,99,0.1,0.1,0.2", "012,20,-14,,0.1,0.1,"])
    write(small, "distances.csv", "from,to,distance,sigma", ["101,109,29.1,0.01"])
    block = read_block_folder(small)
    control, stations, distances = block.groups
    assert (stations.structure.kind, distances.structure.kind) == (STATIONS, DISTANCES)
    np.testing.assert_array_equal(stations.structure.indices, [[2], [1]])
    np.testing.assert_array_equal(stations.structure.observed, [[1, 1, 1], [1, 1, 0]])
    np.testing.assert_array_equal(distances.structure.indices, [[0, 8]])
    np.testing.assert_array_equal([distances.values, distances.sigmas], [[[29.1]], [[0.01]]])
    assert block.n_observations == 96 + control.count + 5 + 1
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


@pytest.mark.parametrize("kind", ["fixed", "minimal"])
def test_held_elements(small: Path, tmp_path: Path, kind: str) -> None:
    hold = '{ "021" = ["Z0", "X0"], 012 = ["kappa"] }'
    append(small, "block.toml", f'[datum]\ntype = "{kind}"\nhold = {hold}')
    block = read_block_folder(small)
    assert block.structure.datum == Datum(kind, (("021", "Z0"), ("021", "X0"), ("012", "kappa")))
    np.testing.assert_array_equal(np.nonzero(~block.structure.exterior_free), [[1, 2, 2], [5, 0, 2]])
    write_block_folder(block, tmp_path / "again")
    again = read_block_folder(tmp_path / "again")
    np.testing.assert_array_equal(again.structure.exterior_free, block.structure.exterior_free)
    assert again.structure.datum.kind == kind and set(again.structure.datum.held) == set(block.structure.datum.held)


def test_chosen_datum_is_written(small: Path, tmp_path: Path) -> None:
    """A block whose minimal datum the package chose reads back with the same elements held."""
    change(small, "block.toml", 29, 'control = "control.csv"', "")
    (small / "control.csv").unlink()
    block = with_datum(read_block_folder(small))
    assert block.structure.datum.kind == "minimal"
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_sigmas_of_single_rays(small: Path, tmp_path: Path) -> None:
    change(small, "rays.csv", 3, ",,", ",0.7,")
    block = read_block_folder(small)
    np.testing.assert_array_equal(block.rays.sigmas[:3], [[0.5, 0.5], [0.7, 0.5], [0.5, 0.5]])
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_what_takes_no_part_is_noted(small: Path) -> None:
    append(small, "control.csv", "900,1,2,3,0,0,0,control")
    append(small, "points.csv", "901,1,2,3\n902,1,2,3")
    write(small, "distances.csv", "from,to,distance,sigma", [])
    change(small, "block.toml", 25, "[tables]", BROWN_CAMERA + "[tables]")
    assert tuple(note.words for note in read_block_folder(small).structure.findings) == (
        "control point 900 is on no image and is not used",
        "2 approximate points are on no image and are not used: 901, 902",
        "camera second one has no image and is not used",
        "distances.csv is not named in [tables] of block.toml and is not used",
    )


@pytest.mark.parametrize(
    ("rows", "columns"),
    [("011,1,2,3,,,", "sX, sY, sZ"), ("011,,,,0.1,0.1,0.1\n012,,,,0.1,0.1,0.1", "sX, sY, sZ")],
)
def test_stations_that_are_not_used_fail(small: Path, rows: str, columns: str) -> None:
    append(small, "block.toml", 'stations = "stations.csv"')
    write(small, "stations.csv", "image,X,Y,Z,sX,sY,sZ", rows.split("\n"))
    (finding,) = read_block_folder(small).structure.findings
    assert (finding.kind, finding.severity) == (Kind.NOT_USED, Severity.FAILED)
    assert [subject.names[0] for subject in finding.subjects] == [row[:3] for row in rows.split("\n")]
    assert columns in finding.what and columns in finding.cure


def test_tables_that_are_not_named(small: Path) -> None:
    """Stations beside control in use are to be checked; control that alone would carry the datum fails."""
    write(small, "stations.csv", "image,X,Y,Z,sX,sY,sZ", ["011,1,2,3,1,1,1"])
    (finding,) = read_block_folder(small).structure.findings
    assert (finding.kind, finding.severity) == (Kind.UNUSED, Severity.CHECK)
    change(small, "block.toml", 29, 'control = "control.csv"', "")
    control, stations = read_block_folder(small).structure.findings
    assert control.kind == stations.kind == Kind.NOT_USED
    assert control.subjects[0].table == "control" and stations.subjects[0].table == "stations"
    assert control.cure == 'add control = "control.csv" there'


def test_weak_points_are_one_line(small: Path) -> None:
    rows = (small / "rays.csv").read_text().splitlines()
    write(small, "rays.csv", rows[0], [row for row in rows[1:] if row[:3] == "011" or row.split(",")[1] < "106"])
    with pytest.raises(BlockError) as caught:
        read_block_folder(small)
    (points,) = caught.value.problems
    assert points.count == 7
    assert points.what == "point 106 is seen on one image only; likewise 107, 108, 109, 110, 111, 112"


def test_forms_of_csv(small: Path) -> None:
    """Byte order mark, CRLF, blanks, empty lines, quotes and another order of columns change nothing."""
    block = read_block_folder(small)
    for file in ("images.csv", "rays.csv", "control.csv"):
        text = (small / file).read_text().replace(",", " ,\t ").replace("\n", "\r\n")
        (small / file).write_bytes(("\ufeff" + text.replace("\r\n", "\r\n \r\n", 4) + "\r\n").encode())
    append(small, "points.csv", '"112", "1",2,3')
    assert_same(block, eqx.tree_at(lambda b: b.object_points, read_block_folder(small), block.object_points))
    rows = [line.split(",") for line in (small / "points.csv").read_text().splitlines()]
    write(small, "points.csv", "Z,X,point,Y", [f"{z},{x},{point},{y}" for point, x, y, z in rows[1:]])
    again = read_block_folder(small)
    np.testing.assert_array_equal(again.object_points[11], [1, 2, 3])
    np.testing.assert_array_equal(again.object_points[:11], block.object_points[:11])


def test_names_that_need_quotes(small: Path, tmp_path: Path) -> None:
    block = read_block_folder(small)
    points = ('tower, "north"', "é point", *block.structure.point_names[2:])
    named = dataclasses.replace(block.structure, point_names=points, name='a "b" \\ c', source="Zürich\nline 2")
    block = dataclasses.replace(block, structure=named)
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_what_cannot_be_written(small: Path, tmp_path: Path) -> None:
    block = read_block_folder(small)
    kind = ObservationKind("tilts", ("tilt",), ("image",), lambda image, observed: (image[0][0] - observed[0],))
    tilts = observation_group(kind, np.zeros((1, 1), int), np.ones((1, 1)), np.ones((1, 1)))
    with pytest.raises(
        BlockError, match="observations of kind 'tilts' have no table in a block folder; leave them out"
    ):
        write_block_folder(eqx.tree_at(lambda b: b.groups, block, (tilts, *block.groups)), tmp_path / "again")
    with pytest.raises(BlockError, match="several groups of kind 'control'"):
        write_block_folder(eqx.tree_at(lambda b: b.groups, block, block.groups * 2), tmp_path / "again")
    own = CameraModel("own", block.structure.model.elements, block.structure.model.residual)
    camera = dataclasses.replace(block.structure.cameras[0], model=own)
    block = dataclasses.replace(block, structure=dataclasses.replace(block.structure, cameras=(camera,)))
    with pytest.raises(BlockError, match="camera wide has the model 'own'; known: none, brown"):
        write_block_folder(block, tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_adjusted_values_are_written(small: Path, tmp_path: Path) -> None:
    block = read_block_folder(small)
    block = eqx.tree_at(lambda b: b.object_points, block, block.object_points.at[5].add(jnp.pi))
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again"))


def test_the_page_shows_a_block_toml(tmp_path: Path) -> None:
    """Every key that it shows is known; only the tables of the fiducials are not named."""
    page = Path(__file__).parents[2] / "jaxbundle" / "docs" / "block-folder.md"
    text = page.read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    (tmp_path / "block.toml").write_text(text, encoding="utf-8")
    noted = Noted()
    assert read_block_toml(tmp_path / "block.toml", noted).settings is not None, str(noted.error())
