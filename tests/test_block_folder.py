import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from folders import append, change, image_coordinates, make_small_folder, object_points, orientations, write

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum import with_datum
from jaxbundle.block.observations import CONTROL, DISTANCES, STATIONS, ObservationKind, observation_group
from jaxbundle.block.problems import BlockError
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA
from jaxbundle.io import read_block_folder, write_block_folder

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
            np.testing.assert_array_equal(getattr(block.structure, field.name), getattr(again.structure, field.name))
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
def test_counts_of_the_real_blocks(shared_data: Path, name: str) -> None:
    block = read_block_folder(shared_data / name)
    expected = json.loads((shared_data / name / "expected.json").read_text())
    assert block.observations == expected["observations"]
    assert block.structure.unknowns == expected["unknowns"]
    assert block.redundancy == expected["redundancy"]
    assert block.structure.name == name
    assert block.structure.notes == ()


@pytest.mark.parametrize("name", FOLDERS)
def test_round_trip_of_the_real_blocks(shared_data: Path, tmp_path: Path, name: str) -> None:
    block = read_block_folder(shared_data / name)
    write_block_folder(block, tmp_path / name)
    assert_same(block, read_block_folder(tmp_path / name))


def test_small_block(small: Path) -> None:
    block = read_block_folder(small)
    structure = block.structure
    assert structure.image_names == ("011", "012", "021", "022")
    assert structure.point_names[:3] == ("101", "102", "103")
    assert block.observations == 2 * 48 + 3 + 2 + 1
    assert structure.unknowns == 4 * 6 + 11 * 3
    assert structure.datum == Datum("open")
    assert structure.cameras[0].metric and structure.cameras[0].width == 4000
    np.testing.assert_array_equal(block.interior.elements, [[50.0, 2010.0, 1490.0, 0.01, -1.0]])
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
    change(small, "points.csv", 4, "103,8.0,-16.0", "103,8.5,")
    block = read_block_folder(small)
    points = object_points()
    np.testing.assert_array_equal(block.object_points[:2], points[:2])
    np.testing.assert_array_equal(block.object_points[2], [8.5, -16.0, -2.9])
    np.testing.assert_array_equal(block.object_points[5], np.round(points[5], 1))
    np.testing.assert_allclose(block.object_points[8:], points[8:], atol=1e-10)


@pytest.mark.parametrize(("unit", "half_turn"), [("deg", 180.0), ("gon", 200.0), ("rad", np.pi)])
def test_units_of_angles(small: Path, tmp_path: Path, unit: str, half_turn: float) -> None:
    change(small, "block.toml", 7, '"deg"', f'"{unit}"')
    rows = [
        f"{name},wide,{','.join(map(repr, [*row[:3], *(row[3:] * half_turn / 180).tolist()]))}"
        for name, row in zip(("011", "012", "021", "022"), orientations(), strict=True)
    ]
    write(small, "images.csv", "image,camera,X0,Y0,Z0,omega,phi,kappa", [row.replace("np.float64", "") for row in rows])
