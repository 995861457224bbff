"""Photographs that cannot be measured are named, all at once; what is only suspicious is said."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

import jaxbundle as jb
from jaxbundle.imagery.exif import Station
from jaxbundle.imagery.xmp import XmpData
from jaxbundle.io.formats.foreign_block import Known
from jaxbundle.measuring.control_marks import ControlMarks
from jaxbundle.measuring.measured_folder import Observed, StationSigmas, write_measured
from jaxbundle.measuring.measured_rays import MeasuredRays
from jaxbundle.measuring.measurement import CameraGiven, MeasureOptions, measure
from jaxbundle.measuring.photo_set import photo_set, read_positions
from jaxbundle.measuring.stations import stations_of

GIVEN = CameraGiven(principal_distance=300.0)


def picture(seed, rows=240, columns=320):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((rows, columns)), 1.0)
    return Image.fromarray(np.clip(128 + 150 * noise, 0, 255).astype(np.uint8))


@pytest.fixture
def photos(tmp_path):
    paths = [tmp_path / f"{name}.png" for name in "abc"]
    for seed, path in enumerate(paths):
        picture(seed).save(path)
    return paths


def test_all_that_is_wrong_is_told_at_once(photos, tmp_path):
    photos[1].write_bytes(photos[1].read_bytes()[:3000])
    Image.new("L", (320, 240), 90).save(photos[2])
    picture(7, 320, 240).save(tmp_path / "turned.png")
    with pytest.raises(jb.imagery.ImageError) as caught:
        photo_set([*photos, tmp_path / "turned.png", tmp_path / "absent.png"], None, GIVEN)
    told = str(caught.value)
    assert told.startswith("4 problems in the images:")
    assert "b.png: is not a readable image" in told
    assert "c.png: is blank: its grey values have a standard deviation of 0.0; leave it out" in told
    assert "turned.png: has 240 x 320 px, a.png of the same camera 320 x 240 px; use the original image" in told
    assert "absent.png: does not exist; check the name" in told


def test_images_given_twice(photos, tmp_path):
    (tmp_path / "copy.png").write_bytes(photos[0].read_bytes())
    with pytest.raises(jb.imagery.ImageError, match=r"copy.png: is the same image as .*a.png; give each image once"):
        photo_set([*photos, tmp_path / "copy.png"], None, GIVEN)
    with pytest.raises(jb.imagery.ImageError, match="has the name of"):
        photo_set([photos[0], *photos], None, GIVEN)


def test_camera_from_exif_or_the_user(photos):
    with pytest.raises(jb.imagery.ImageError, match="camera camera: has an unknown principal distance; give --princ"):
        photo_set(photos)
    exif = Image.Exif()
    exif[272], exif[274] = "X100", 6
    exif.get_ifd(0x8769).update({37386: 23.0, 41989: 35})
    paths = [path.with_suffix(".jpg") for path in photos]
    for seed, path in enumerate(paths):
        picture(seed).save(path, exif=exif)
    found = photo_set(paths)
    assert found.principal_distances == {"X100 23 mm": pytest.approx(35 / 36 * 320)}
    assert [finding.what for finding in found.findings] == [
        f"image {path.name} has an orientation in its EXIF data, which is not applied" for path in paths
    ]
    assert photo_set(paths, None, CameraGiven(sensor_width=23.0)).principal_distances["X100 23 mm"] == 320.0


def test_blurred_image_is_named(photos, tmp_path):
    blurred = ndimage.gaussian_filter(np.asarray(picture(9), float), 6.0)
    Image.fromarray(np.clip(128 + 5 * (blurred - blurred.mean()), 0, 255).astype(np.uint8)).save(tmp_path / "d.png")
    found = photo_set([*photos, tmp_path / "d.png"], None, GIVEN).findings
    assert [finding.subjects[0].names for finding in found] == [("d.png",)]
    assert "is blurred: its neighbouring grey values differ by" in found[0].words


def test_images_without_overlap(photos):
    with pytest.raises(jb.imagery.ImageError, match="no two images have common points; give images that overlap"):
        measure(photos, options=MeasureOptions(camera=GIVEN, number=64))
    with pytest.raises(jb.imagery.ImageError, match="there is one image only"):
        measure(photos[:1], options=MeasureOptions(camera=GIVEN))


def test_table_of_positions(tmp_path):
    path = tmp_path / "gps.csv"
    path.write_text("image,latitude,longitude,altitude,time\na.png,46.8,-91.9,198.3,x\n")
    assert read_positions(path) == {"a.png": Station(46.8, -91.9, 198.3)}
    path.write_text("image,latitude,longitude,altitude\na.png,46.8,west,198.3\n")
    with pytest.raises(jb.imagery.ImageError, match="image a.png: a field is not a number"):
        read_positions(path)
    path.write_text("image,lat,lon\na.png,46.8,2\n")
    with pytest.raises(jb.imagery.ImageError, match="has no column latitude, longitude, altitude"):
        read_positions(path)


def test_block_folder(photos, tmp_path):
    image, point = np.array([0, 1, 0, 1, 2]), np.array([0, 0, 1, 1, 1])
    xy = np.arange(10.0).reshape(5, 2)
    rays = MeasuredRays(image, point, xy, np.full((5, 2), 0.1), {})
    stations = np.array([[0.0, 0, 100], [10, 0, 100], [np.nan] * 3])
    write_measured(tmp_path / "block", photo_set(photos, None, GIVEN), rays, stations, StationSigmas())
    tables = {path.name: path.read_text().splitlines() for path in (tmp_path / "block").iterdir()}
    assert tables["images.csv"][:2] == ["image,camera,X0,Y0,Z0,omega,phi,kappa", "a.png,camera,,,,,,"]
    assert tables["rays.csv"][5] == "c.png,2,8.0,9.0,0.1,0.1"
    assert tables["stations.csv"][1:] == [
        "a.png,0.0,0.0,100.0,1.0,1.0,1.5,receiver",
        "b.png,10.0,0.0,100.0,1.0,1.0,1.5,receiver",
    ]
    assert "priors = { principal_distance = 9.0 }" in tables["block.toml"]
    assert "priors = { shift = 5.0 }" in tables["block.toml"]


def test_block_folder_with_attitudes_and_control(photos, tmp_path):
    own = photo_set(photos, None, GIVEN)
    recorded = XmpData(None, (45.0, -90.0, 0.0), (0.01, 0.01, 0.02))
    own = own._replace(photos=(own.photos[0]._replace(xmp=recorded), *own.photos[1:]))
    rays = MeasuredRays(np.arange(3), np.zeros(3, int), np.zeros((3, 2)), np.full((3, 2), 0.1), {})
    points = (Known("1", (500.0, 700.0, np.nan), (0.02, 0.02, 0.03)),)
    marks = ControlMarks(
        points, np.array([1, 2]), np.array([0, 0]), np.array([[5.0, 6.0], [7.0, 8.0]]), np.zeros(2, int)
    )
    stations = np.array([[0.0, 0, 100], [10, 0, 100], [np.nan] * 3])
    write_measured(tmp_path / "b", own, rays, stations, StationSigmas(), observed=Observed(marks, 3.0))
    tables = {path.name: path.read_text().splitlines() for path in (tmp_path / "b").iterdir()}
    assert tables["stations.csv"][1:] == [
        "a.png,0.0,0.0,100.0,0.01,0.01,0.02,",
        "b.png,10.0,0.0,100.0,1.0,1.0,1.5,receiver",
    ]
    assert tables["control.csv"][1:] == ["1,500.0,700.0,,0.02,0.02,,control"]
    assert tables["rays.csv"][3:] == [
        "c.png,tie-1,0.0,0.0,0.1,0.1",
        "b.png,1,5.0,6.0,1.0,1.0",
        "c.png,1,7.0,8.0,1.0,1.0",
    ]
    image, *angles = tables["attitudes.csv"][1].split(",")
    assert image == "a.png"
    np.testing.assert_allclose(np.array(angles, float), [0, 0, -45, 3, 3, 3], atol=1e-5)
    assert len(tables["attitudes.csv"]) == 2


def test_stations_in_the_system_of_the_control(photos, tmp_path):
    given = {"a.png": Station(46.8425, -91.995, 198.5), "b.png": Station(46.8427, -91.994, 199.5)}
    own, list_of = photo_set(photos, None, GIVEN, given), tmp_path / "gcp_list.txt"
    about_mean, nothing = stations_of(own, None)
    assert nothing is None and np.isnan(about_mean[2]).all()
    np.testing.assert_allclose(about_mean[:2, :2].sum(0), 0, atol=0.01)
    list_of.write_text("EPSG:32615\n576600 5187900 180 20 30 a.png g1\n")
    stations, control = stations_of(own, list_of)
    assert control is not None and control.coordinate_system == "EPSG:32615"
    lengths = [np.linalg.norm((places[1] - places[0])[:2]) for places in (stations, about_mean)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-3)
    assert 576_000 < stations[0, 0] < 577_000 and stations[0, 2] == 198.5
    list_of.write_text("500 700 180 20 30 a.png g1\n")
    assert np.isnan(stations_of(own, list_of)[0]).all()
