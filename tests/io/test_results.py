"""Results for maps, clouds and drawings: what other programs read from them."""

import dataclasses
import importlib
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from jaxbundle.block.problems import BlockError
from jaxbundle.io import export, read
from jaxbundle.io.formats.ply_files import ply_vertices
from jaxbundle.io.results.map_features import features_of
from jaxbundle.io.results.maps import outline
from jaxbundle.solve.adjust import adjust


@pytest.fixture(scope="module")
def result(shared_data):
    """An adjusted block with control, in a system that is known."""
    block = read(shared_data / "strasbourg-s2-weighted", check_start=False)
    structure = dataclasses.replace(block.structure, source="DBAT; coordinate system: EPSG:27561")
    return adjust(dataclasses.replace(block, structure=structure))


@pytest.fixture(scope="module")
def points(result):
    return np.asarray(result.block.object_points)


def test_a_cloud_keeps_double_precision(tmp_path, result, points):
    export(result, tmp_path / "a.ply")
    content = (tmp_path / "a.ply").read_bytes()
    rows = ply_vertices(tmp_path / "a.ply", content, ("x", "y", "z", "sX", "rays"))
    offset = [float(x) for x in re.findall(rb"offset to be added: (.*)\n", content)[0].split()]
    np.testing.assert_allclose(np.column_stack([rows[axis] for axis in "xyz"]) + offset, points, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rows["sX"], np.asarray(result.standard_deviations.object_points)[:, 0], rtol=1e-6)
    assert rows["rays"].sum() == 47
    export(result.block, tmp_path / "b.ply")
    assert b"property float sX" not in (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_laspy_reads_the_cloud(tmp_path, result, points, suffix):
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    export(result, tmp_path / f"a{suffix}")
    cloud = laspy.read(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(np.column_stack([cloud.x, cloud.y, cloud.z]), points, atol=5.1e-4)
    np.testing.assert_allclose(cloud["sZ"], np.asarray(result.standard_deviations.object_points)[:, 2], rtol=1e-6)
    assert cloud.header.parse_crs().to_epsg() == 27561


def test_pyogrio_reads_the_geopackage(tmp_path, result, points):
    pytest.importorskip("pyogrio")
    pyogrio = importlib.import_module("pyogrio.raw")
    export(result, tmp_path / "a.gpkg")
    meta, _, geometry, fields = pyogrio.read(tmp_path / "a.gpkg", layer="points")
    assert meta["crs"] == "EPSG:27561" and meta["fields"].tolist() == ["point", "rays", "sX", "sY", "sZ"]
    np.testing.assert_array_equal(np.array([np.frombuffer(row[5:], "<f8") for row in geometry]), points)
    assert fields[0].tolist() == list(result.block.structure.point_names)
    layers = {name for name, _ in importlib.import_module("pyogrio").list_layers(tmp_path / "a.gpkg")}
    assert layers == {"points", "images", "residuals", "ellipses"}


def test_maps_are_in_longitude_and_latitude(tmp_path, result):
    pytest.importorskip("pyproj")
    export(result, tmp_path / "a.geojson")
    rows = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert {row["properties"]["layer"] for row in rows} == {"points", "images", "residuals", "ellipses"}
    longitude, latitude, _ = rows[0]["geometry"]["coordinates"]
    assert 7.0 < longitude < 8.5 and 48.0 < latitude < 49.0  # Strasbourg
    export(result, tmp_path / "a.kml")
    root = ElementTree.parse(tmp_path / "a.kml").getroot()
    assert len(list(root.iter("{http://www.opengis.net/kml/2.2}Placemark"))) == len(rows)


def test_a_map_needs_a_system(tmp_path, result):
    pytest.importorskip("pyproj")
    structure = dataclasses.replace(result.block.structure, source="")
    with pytest.raises(
        BlockError, match="a.kml needs longitude and latitude, and the coordinate system of the block is"
    ):
        export(dataclasses.replace(result.block, structure=structure), tmp_path / "a.kml")


def test_ezdxf_reads_the_drawing(tmp_path, result):
    ezdxf = pytest.importorskip("ezdxf")
    export(result, tmp_path / "a.dxf")
    drawing = ezdxf.readfile(tmp_path / "a.dxf")
    found = {entity.dxf.layer for entity in drawing.modelspace()}
    assert found == {"POINTS", "IMAGES", "RESIDUALS", "ELLIPSES"}


def test_features_are_those_of_the_adjustment(result, points):
    found = features_of(result)
    assert found.ellipses is not None
    (group,) = (group for group in result.block.groups if group.structure.kind.name == "control")
    k = group.structure.indices[0, 0]
    np.testing.assert_allclose(found.vectors.residual[0], points[k] - np.asarray(group.values)[0], atol=1e-12)
    corners = outline(found, 0) - points[0]
    radius = np.linalg.norm(corners[:, :2], axis=1) / found.ellipse_scale
    np.testing.assert_allclose(radius.max(), found.ellipses.axes[0, 0], rtol=1e-2)
    assert np.log10(found.vector_scale) % 1 == 0


def test_exports_that_cannot_be(tmp_path, result):
    with pytest.raises(ValueError, match="a.shp has no known suffix; known: .ply, .las"):
        export(result, tmp_path / "a.shp")
    (tmp_path / "a.ply").touch()
    with pytest.raises(FileExistsError, match="exists; give another name"):
        export(result, tmp_path / "a.ply")
