"""Control and stations beside a block: gcp_list.txt, geo.txt, tables, coordinate systems, several sources at once."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from jaxbundle.block.findings import Kind, Severity
from jaxbundle.block.problems import BlockError
from jaxbundle.io import Sources, read
from jaxbundle.io.formats import extras
from jaxbundle.io.formats.attitudes import observed_attitudes, rotations_of_gimbal
from jaxbundle.io.formats.colmap import read_colmap
from jaxbundle.io.formats.coordinates import convergence, is_geographic, metric, transformed, utm_zone
from jaxbundle.io.formats.foreign_block import Known, triple
from jaxbundle.io.formats.ground_control import read_control, read_positions, with_control
from jaxbundle.io.formats.misfit import ray_residuals
from jaxbundle.io.formats.photograph_data import positions_of_photographs, read_photograph
from jaxbundle.io.formats.rotations import to_angles


def test_a_list_of_opendronemap(shared_data):
    found = read_control(shared_data / "exchange" / "odm" / "copr_gcp_list.txt")
    assert (len(found.points), len(found.rays)) == (10, 27)
    assert found.coordinate_system.startswith("+proj=utm +zone=11")
    first = found.points[0]
    assert first.name == "gcp02" and first.coordinates == (235269.88, 3811198.11, 0.0)
    assert first.sigmas == (0.05, 0.05, 0.1)
    assert found.rays[0] == ("gcp02", "IMG_0037.jpg", 3609.3727839973153 + 0.5, 2293.7951481487607 + 0.5)
    assert "assumed are 0.05 m in plan and 0.1 m in height" in found.findings[-1].words


def test_rows_of_a_list(tmp_path):
    """Byte order mark, comments, blanks for tabs, unknown heights, points known by their coordinates."""
    path = tmp_path / "gcp_list.txt"
    text = "\ufeffEPSG:32633\r\n# comment\r\n500000 5400000 NaN 10 20 a.jpg\r\n500000 5400000 NaN 30 40 b.jpg\r\n"
    path.write_text(text + "500010 5400000 70 1 2 a.jpg P1\r\n500010 5400000 70.5 1 2 b.jpg P1\r\n", encoding="utf-8")
    found = read_control(path, sigma=(0.02, 0.03))
    assert [point.name for point in found.points] == ["(500000, 5400000, NaN)", "P1"]
    assert np.isnan(found.points[0].coordinates[2]) and found.points[1].sigmas == (0.02, 0.02, 0.03)
    assert len(found.rays) == 4
    (finding,) = found.findings
    assert "point P1 has two positions, 500010 5400000 70 and 500010 5400000 70.5; the first is used" in finding.words
    path.write_text("EPSG:32633\n500000 5400000 x 10 20 a.jpg\n1 2 3 4\n", encoding="utf-8")
    with pytest.raises(BlockError) as caught:
        read_control(path)
    assert caught.value.lines == (
        "gcp_list.txt:2: 'x' is not a finite number; correct it, or export it again",
        "gcp_list.txt:3: the row has 4 fields, not x y z u v image [name]; correct it, or export it again",
    )


def test_tables_with_a_header(tmp_path):
    path = tmp_path / "control.csv"
    path.write_text("point,X,Y,Z,sX,sY,sZ,role\nA,1,2,3,0.01,0.02,,control\nB,4,5,6,0,0,0,check\n", encoding="utf-8")
    a, b = read_control(path).points
    assert a.sigmas[:2] == (0.01, 0.02) and np.isnan(a.sigmas[2]) and not a.check and b.check
    path.write_text("#Label;X/Easting;Y/Northing;Z/Altitude\nA;1;2;3\n", encoding="utf-8")
    (point,) = read_control(path).points
    assert point.coordinates == (1.0, 2.0, 3.0) and point.sigmas == (0.05, 0.05, 0.1)


def made_table(shared_data: Path, path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Five points of the rig as control in another system, their rays as computed; rotation, shift, scale of it."""
    foreign = read_colmap(shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin")
    turn, shift, scale = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([500_000.0, 5_400_000.0, 300.0]), 7.5
    v, _ = ray_residuals(foreign)
    xy = foreign.rays.xy + v * [1, -1]
    rows = ["EPSG:32633"]
    for point in (3, 11, 19, 27, 41):
        x, y, z = scale * turn @ foreign.points.coordinates[point] + shift
        for ray in np.flatnonzero(foreign.rays.point == point)[:4]:
            u, w = xy[ray] - 0.5
            name = foreign.images.names[foreign.rays.image[ray]].removesuffix(".png")
            rows.append(f"{x:.6f} {y:.6f} {z:.6f} {u:.6f} {w:.6f} {name}.JPG K{point}")
    path.write_text("\n".join(rows), encoding="utf-8")
    return turn, shift, scale


def test_control_brings_a_block_into_its_system(shared_data, tmp_path):
    """Names of images may differ in case and extension."""
    folder = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    turn, shift, scale = made_table(shared_data, tmp_path / "gcp_list.txt")
    block = read(folder, sources=Sources(control=tmp_path / "gcp_list.txt"), check_start=False)
    plain = read(folder, check_start=False)
    expected = scale * np.asarray(plain.exterior.projection_centre) @ turn.T + shift
    np.testing.assert_allclose(block.exterior.projection_centre, expected, atol=1e-4)
    assert len(block.structure.point_names) == 65 and block.groups[0].count == 15
    words = " ".join(finding.words for finding in block.structure.findings)
    assert "the block was transformed into the system of 5 control points: scale 7.5, misfit" in words
    assert "coordinate system: EPSG:32633" in block.structure.source


def test_stations_bring_a_block_into_their_system(shared_data, tmp_path):
    folder = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    plain = read(folder, check_start=False)
    rows = [
        f"{name}\t{2 * x + 1000:.9f}\t{2 * y:.9f}\t{2 * z:.9f}"
        for name, (x, y, z) in zip(plain.structure.image_names, plain.exterior.projection_centre.tolist(), strict=True)
    ]
    (tmp_path / "geo.txt").write_text("EPSG:32633\n" + "\n".join(rows), encoding="utf-8")
    block = read(folder, sources=Sources(stations=tmp_path / "geo.txt", station_sigma=(0.1, 0.2)), check_start=False)
    expected = 2 * np.asarray(plain.object_points) + [1000, 0, 0]
    np.testing.assert_allclose(block.object_points, expected, atol=1e-6)
    np.testing.assert_allclose(block.groups[0].sigmas, np.tile([0.1, 0.1, 0.2], (8, 1)))


def test_control_that_does_not_fit_is_told(shared_data, tmp_path):
    folder = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    (tmp_path / "gcp_list.txt").write_text("EPSG:32633\n1 2 3 4 5 nowhere.jpg A\n1 2 9 4 5 nowhere.jpg B\n")
    block = read(folder, sources=Sources(control=tmp_path / "gcp_list.txt"), check_start=False)
    failed = [finding for finding in block.structure.findings if finding.severity is Severity.FAILED]
    assert failed and failed[0].kind is Kind.NOT_USED
    assert "2 rays of control are on 1 images that are not in the block, such as nowhere.jpg" in failed[0].words
    with pytest.raises(BlockError, match="additional tables are not read; put control.csv and stations.csv into"):
        read(shared_data / "strasbourg-s4-tie", sources=Sources(control=tmp_path / "gcp_list.txt"))


def test_positions_with_angles(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:4326\na.jpg 13.4 52.5 100 45 0.1 0 0.02 0.05\nb.jpg 13.5 52.5\n", encoding="utf-8")
    found = read_positions(path)
    a, b = found.stations
    assert a.sigmas == (0.02, 0.02, 0.05) and b.sigmas == (5.0, 5.0, 30.0) and np.isnan(b.coordinates[2])
    assert found.attitudes[0].coordinates == (45.0, 0.1 - 90.0, 0.0)  # of a gimbal


def test_geographic_coordinates_become_metric(tmp_path):
    pytest.importorskip("pyproj")
    path = tmp_path / "gcp_list.txt"
    path.write_text("WGS84\n13.4 52.5 35 1 2 a.jpg A\n13.41 52.51 36 1 2 a.jpg B\n", encoding="utf-8")
    control, _ = metric(read_control(path), None)
    assert control is not None and control.coordinate_system == "EPSG:32633"
    back = transformed("EPSG:32633", "EPSG:4979", np.array([control.points[0].coordinates]))
    np.testing.assert_allclose(back, [[13.4, 52.5, 35.0]], rtol=1e-9)
    np.testing.assert_allclose(control.points[0].coordinates, (391_391, 5_817_855, 35.0), atol=1.0)
    assert "heights are unchanged" in control.findings[-1].words
    path.write_text("WGS84\n52.5 313.4 35 1 2 a.jpg A\n", encoding="utf-8")
    with pytest.raises(BlockError, match="give the longitude first, then the latitude"):
        metric(read_control(path), None)
    assert utm_zone(-70.0, -33.0) == "EPSG:32719" and is_geographic("EPSG:4326") and not is_geographic("WGS84 UTM 17N")


def test_heights_are_never_guessed():
    """Without the grid of the geoid a height in DHHN2016 has no exact ellipsoidal height."""
    pytest.importorskip("pyproj")
    with pytest.raises(BlockError, match="install the grids that PROJ asks for"):
        transformed("EPSG:4979", "EPSG:5555", np.array([[9.0, 50.0, 300.0]]))
    with pytest.raises(BlockError, match="the coordinate system 'EPSG:99999999' is unknown"):
        transformed("EPSG:4979", "EPSG:99999999", np.zeros((1, 3)))


def test_convergence_of_meridians():
    """Of UTM to first order (lambda - lambda_0) sin phi."""
    pytest.importorskip("pyproj")
    place = transformed("EPSG:4979", "EPSG:32633", np.array([[16.0, 50.0, 0.0]]))
    assert np.degrees(convergence("EPSG:32633", place)[0]) == pytest.approx(np.sin(np.radians(50.0)), rel=1e-3)


def test_attitudes_of_a_gimbal():
    found = np.degrees(to_angles(rotations_of_gimbal(np.array([[0, -90, 0], [45, -89.9, 0], [0, 0, 0.0]]))))
    expected = [[0, 0, 0], [0.0707107, -0.0707107, -45.0], [90, 0, 0]]
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_attitudes_are_observed_in_the_grid():
    """Yaw is from true north: in the grid the convergence is subtracted."""
    pytest.importorskip("pyproj")
    place = transformed("EPSG:4979", "EPSG:32633", np.array([[16.0, 50.0, 300.0]]))
    nothing = (np.nan, np.nan, np.nan)
    rows = Known("a", (30.0, -90.0, 0.0), nothing), Known("b", (30.0, -90.0, 0.0), nothing)
    (found,) = observed_attitudes(rows, (Known("a", triple(place[0]), (1.0, 1.0, 1.0)),), "EPSG:32633", 2.0)
    gamma = np.degrees(convergence("EPSG:32633", place)[0])
    np.testing.assert_allclose(np.degrees(found.coordinates), [0, 0, -(30.0 - gamma)], atol=1e-12)
    assert found.sigmas == (np.radians(2.0),) * 3
    (local,) = observed_attitudes(rows[:1], (Known("a", (0.0, 0.0, 0.0), nothing),), "", 2.0)
    np.testing.assert_allclose(np.degrees(local.coordinates), [0, 0, -30.0], atol=1e-12)


def test_a_photograph_tells_its_position(shared_data, tmp_path):
    pytest.importorskip("PIL")
    path = shared_data / "exchange" / "exif" / "DJI_0018_header.jpg"
    found = read_photograph(path)
    assert (found.width, found.height) == (4000, 2250)
    longitude, latitude, altitude = found.position
    assert latitude == pytest.approx(46 + 50 / 60 + 33.3855 / 3600, abs=1e-7)
    assert longitude == pytest.approx(-(91 + 59 / 60 + 40.4156 / 3600), abs=1e-7) and altitude == 198.309
    assert found.gimbal == (45.0, -89.9, 0.0) and found.sigmas == (5.0, 5.0, 30.0)
    assert found.focal_length == pytest.approx(20 / 43.27 * np.hypot(4000, 2250))
    (tmp_path / "a.jpg").write_bytes(path.read_bytes())
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    positions = positions_of_photographs(tmp_path)
    assert len(positions.stations) == 1 and len(positions.attitudes) == 1
    assert "1 of 2 photographs have no position" in positions.findings[0].words


def test_a_missing_package_is_told_with_its_extra(monkeypatch):
    def absent(module: str):
        raise ImportError(module)

    monkeypatch.setattr(extras.importlib, "import_module", absent)
    with pytest.raises(BlockError, match="reading EXIF needs the package pillow, which is not installed; install it"):
        extras.extra("PIL.Image", "reading EXIF")


def test_points_of_a_block_may_be_control(shared_data, tmp_path):
    """A table without image coordinates gives control to points that have these names already."""
    foreign = read_colmap(shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin")
    path = tmp_path / "control.csv"
    path.write_text(f"point,X,Y,Z,sX,sY,sZ\n{foreign.points.names[0]},1,2,3,0.1,0.1,0.1\n", encoding="utf-8")
    found = with_control(foreign, read_control(path))
    assert found.points.names == foreign.points.names and len(found.control) == 1
    assert dataclasses.replace(found, control=()).rays.xy.shape == foreign.rays.xy.shape
