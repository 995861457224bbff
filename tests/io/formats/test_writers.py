"""Blocks written and read again in every format that is written: the residuals stay, and what is lost is said."""

import dataclasses
import importlib
import sqlite3
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.forward import AICON, BAL, BROWN_FORWARD, METASHAPE
from jaxbundle.camera.lenses import DIVISION, EUCM, FISHEYE, FISHEYE_624, FOV, RATIONAL
from jaxbundle.io import read, write_format
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.colmap_cameras import MODELS, camera_from_colmap, colmap_from_camera
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    ForeignBlock,
    ForeignCamera,
    Images,
    Known,
    Points,
    RayTable,
    ReadOptions,
    element,
)
from jaxbundle.io.formats.format_table import FORMATS, read_format
from jaxbundle.io.formats.intersected import with_intersections
from jaxbundle.io.formats.misfit import ray_residuals
from jaxbundle.io.formats.written import foreign_block

MADE = ("colmap", "colmap-text", "opensfm", "blocksexchange", "bundler", "nvm", "bingo", "patb", "inpho")
MADE = (*MADE, "micmac", "opf", "pix4d")
NUMBERED = ("bingo", "patb", "inpho", "pix4d")  # names with blanks become numbers there
WITHOUT_POINTS = ("patb", "micmac", "pix4d")
ROUNDING = {
    "patb": 2e-2,
    "micmac": 5e-2,
    "pix4d": 5e-2,
    "opf": 5e-3,
    "inpho": 1e-5,
}  # px: digits of the format; intersections of corrected rays
SIZE = ReadOptions((4000, 3000))
PX = {"principal_distance": 3000.0, "x0": 2010.0, "y0": 1490.0}
CAMERAS = {
    "metashape": (METASHAPE, {**PX, "K1": -0.1, "K2": 0.05, "P1": 1e-3, "P2": -5e-4, "b1": 3.0}, "px"),
    "skewed": (METASHAPE, {**PX, "K4": 0.01, "b2": 1.0}, "px"),
    "free": (DISTORTION_FREE, {**PX, "pixel_size": 1.0}, "px"),
    "metric": (DISTORTION_FREE, {"principal_distance": 15.0, "x0": 2010.0, "y0": 1490.0, "pixel_size": 0.005}, "px"),
    "brown": (BROWN, {**PX, "K1": -1e-9, "P1": 1e-8}, "px"),
    "brown-forward": (BROWN_FORWARD, {**PX, "K1": -1e-9, "K2": 1e-17, "P1": 1e-8, "P2": -2e-8}, "px"),
    "aicon": (AICON, {"principal_distance": 15.0, "A1": -1e-5, "R0": 5.0, "C1": 1e-4}, "mm"),
    "bal": (BAL, {"principal_distance": 3000.0, "k1": -0.1, "k2": 0.02}, "px"),
    "rational": (RATIONAL, {**PX, "K1": 0.2, "K4": 0.3, "P1": 1e-3}, "px"),
    "fisheye": (FISHEYE, {**PX, "K1": 0.02, "K3": -0.01, "S1": 1e-3}, "px"),
    "fisheye-624": (FISHEYE_624, {**PX, "K1": 0.02, "S4": 1e-3, "b1": 2.0}, "px"),
    "fov": (FOV, {**PX, "omega": 0.9}, "px"),
    "division": (DIVISION, {**PX, "k": -0.1}, "px"),
    "eucm": (EUCM, {**PX, "alpha": 0.5, "beta": 1.1}, "px"),
}


def made(camera: str, names: tuple[str, ...], shift: np.ndarray, seed: int = 0) -> ForeignBlock:
    """Four photographs above 12 points, one of which sees nothing; rays with errors of about a pixel."""
    rng = np.random.default_rng(seed)
    model, elements, unit = CAMERAS[camera]
    size = (4000, 3000) if model is not BAL and unit == "px" else (None, None)
    one = ForeignCamera("camera 1", model, elements, ("principal_distance",), unit, *size)
    centre = shift + np.c_[rng.uniform(-20, 20, (4, 2)), np.full(4, 100.0)]
    angle = rng.normal(0, 0.1, (4, 3))
    turned = np.array([_small(a) for a in angle])
    points = shift + np.c_[rng.uniform(-25, 25, (12, 2)), rng.uniform(-5, 5, 12)]
    image, point = np.repeat(np.arange(3), 12), np.tile(np.arange(12), 3)
    point_names = ("K 1", "K 2", "K 3", *(f"p{k * 7}" for k in range(9)))
    control = tuple(
        Known(name, tuple((place + 0.01).tolist()), (0.02, 0.02, 0.04), k == 2)
        for k, (name, place) in enumerate(zip(point_names[:3], points, strict=False))
    )
    foreign = ForeignBlock(
        "made", "made block", (one,), Images(names, np.zeros(4, int), turned, centre), Points(point_names, points),
        RayTable(image, point, np.zeros((36, 2)), np.ones(36)), control,
    )  # fmt: skip
    scale = [1.0, -1.0] if unit == "px" and model is not BAL else [1.0, 1.0]
    v, _ = ray_residuals(foreign)
    noise = rng.normal(0, 1.0 if unit == "px" else 0.005, (36, 2))
    xy = np.zeros((36, 2))
    for _ in range(20):  # a measurement whose residual vanishes: a fixed point also of models that correct it
        xy = xy + v * scale
        v, _ = ray_residuals(dataclasses.replace(foreign, rays=foreign.rays._replace(xy=xy)))
    return dataclasses.replace(foreign, rays=foreign.rays._replace(xy=xy + noise))


def _small(angle: np.ndarray) -> np.ndarray:
    """A rotation by three angles about the axes."""
    x, y, z = angle
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return rx @ ry @ rz


TEXT = ("bingo", "patb", "inpho", "micmac")  # formats with fewer digits
FULL = ("colmap", "colmap-text", "opensfm", "blocksexchange")
NAMES = ("a.jpg", "b.jpg", "c.jpg", "d.jpg")


@cache
def block_of(camera: str) -> Block:
    return assembled(made(camera, NAMES, np.zeros(3)))


def residuals(block: Block | ForeignBlock, pixel: float = 1.0) -> np.ndarray:
    """Residuals in px, x and y each in order: files number their rays differently."""
    foreign = foreign_block(block) if isinstance(block, Block) else block
    v, _ = ray_residuals(foreign)
    return np.sort(v, axis=0) / pixel


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("camera", ["metashape", "skewed", "brown", "metric", "aicon", "bal"])
def test_residuals_survive(tmp_path, name, camera):
    """Exactly for a camera that the format holds, by corrected measurements for any other."""
    block = block_of(camera)
    path = tmp_path / f"out{FORMATS[name].suffix}"
    losses = write_format(block, path, name)
    again = read_format(path, name, SIZE if name in ("nvm", "bundler") else DEFAULT)
    unit = CAMERAS[camera][2]
    of_file = 0.005 if name in ("bingo", "patb") else 1.0
    expected = residuals(block, 0.005 if unit == "mm" else 1.0)
    if name in WITHOUT_POINTS:  # they have no points: both intersect them
        again, expected = with_intersections(again), residuals(_intersected(block), 0.005 if unit == "mm" else 1.0)
    elif name in ("blocksexchange", "opf"):  # control points have the coordinates that are known
        again, expected = _ties(again), residuals(_ties(foreign_block(block)), 0.005 if unit == "mm" else 1.0)
    np.testing.assert_allclose(residuals(again, of_file), expected, atol=ROUNDING.get(name, 1e-6))
    told = " ".join(losses)
    assert ("the format cannot represent the model" in told) == (camera in _corrected(name))


def _intersected(block: Block) -> ForeignBlock:
    """The block with points as its rays give them."""
    foreign = foreign_block(block)
    nowhere = np.full(foreign.points.coordinates.shape, np.nan)
    return with_intersections(dataclasses.replace(foreign, points=foreign.points._replace(coordinates=nowhere)))


def _ties(foreign: ForeignBlock) -> ForeignBlock:
    """The block with the rays of tie points only."""
    control = ("K 1", "K 2", "K 3")
    tie = np.array([foreign.points.names[k] not in control for k in foreign.rays.point])
    rays = foreign.rays
    return dataclasses.replace(foreign, rays=RayTable(rays.image[tie], rays.point[tie], rays.xy[tie]))


def _corrected(name: str) -> set[str]:
    always = {"brown", "aicon", "skewed"}
    if name == "micmac":
        return {"brown", "aicon", "metashape", "skewed"}
    if name in ("bingo", "patb", "inpho", "nvm"):
        return always | {"metashape", "bal"}
    return always | ({"metashape"} if name in ("bundler", "opf") else set())


@pytest.mark.parametrize("camera", ["rational", "fisheye", "fisheye-624", "fov", "division", "eucm", "brown-forward"])
def test_lenses_of_colmap_go_both_ways(tmp_path, camera):
    block = block_of(camera)
    write_format(block, tmp_path / "out", "colmap")
    again = read(tmp_path / "out", check_start=False)
    np.testing.assert_allclose(residuals(again), residuals(block), atol=1e-8)


def test_parameters_of_colmap_go_both_ways():
    """Every model that is read is written with the same numbers, by the simplest model that holds them."""
    for model in (model for model in MODELS if model.model):
        values = [3000.0, 3001.0, 2000.0, 1500.0] if "fx" in model.parameters else [3000.0, 2000.0, 1500.0]
        values += [0.01 * (k + 1) for k in range(len(model.parameters) - len(values))]
        found = colmap_from_camera(camera_from_colmap("1", model, 4000, 3000, values))
        assert found is not None and found[0] is model
        np.testing.assert_allclose(found[1], values, rtol=1e-15)


def test_pycolmap_projects_alike(tmp_path):
    """The oracle reads what is written and computes the same image points, for each lens."""
    pycolmap = pytest.importorskip("pycolmap")
    for camera in ("metashape", "rational", "fisheye", "fisheye-624", "fov", "division", "eucm"):
        block = block_of(camera)
        write_format(block, tmp_path / camera, "colmap")
        model = pycolmap.Reconstruction(str(tmp_path / camera))
        found = []
        for image in model.images.values():
            for seen in image.points2D:
                point = model.points3D[seen.point3D_id].xyz
                uv = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * point)
                found.append((uv - seen.xy) * [1, -1])
        np.testing.assert_allclose(np.sort(found, axis=0), residuals(block), atol=1e-8)


def test_the_oracle_of_opf_reads_what_is_written(tmp_path):
    """pyopf, where it is installed."""
    pytest.importorskip("pyopf")
    write_format(block_of("free"), tmp_path / "opf", "opf")
    project = importlib.import_module("pyopf.io").load(str(tmp_path / "opf" / "project.opf"))
    assert project.name == "made block" and len(project.items) == 7


@settings(max_examples=30)
@given(
    names=st.lists(
        st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=12),
        min_size=4, max_size=4, unique_by=str.lower,
    ),
    folder=st.sampled_from(["", "left/", "a b/", "Ü/"]),
    easting=st.sampled_from([0.0, 500_000.25, -7_000_000.0]),
    name=st.sampled_from(MADE),
    seed=st.integers(0, 3),
)  # fmt: skip
def test_names_and_places_survive(tmp_path_factory, names, folder, easting, name, seed):
    """Names with blanks and folders, map coordinates, an image without rays."""
    photographs = tuple(f"{folder}{text} {k}.jpg" for k, text in enumerate(names))
    block = assembled(made("metashape", photographs, np.array([easting, 5_400_000.5, 300.0]), seed))
    assert len(block.structure.image_names) == 3  # the fourth sees nothing
    path: Path = tmp_path_factory.mktemp("written") / f"out{FORMATS[name].suffix}"
    write_format(block, path, name)
    again = read_format(path, name, SIZE if name in ("nvm", "bundler") else DEFAULT)
    numbers = next(iter(path.parent.rglob("names.csv")), None)
    written = again.images.names
    if name in NUMBERED and numbers is not None:
        rows = numbers.read_text(encoding="utf-8").splitlines()
        own = dict((row.split(",", 2)[1], row.split(",", 2)[2][1:-1]) for row in rows if row.startswith("image,"))
        written = tuple(own.get(number, number) for number in written)
    order = [written.index(one) for one in block.structure.image_names]
    assert len(written) == 3 and np.unique(order).size == 3
    shift = _shift(path) if name == "bundler" else 0.0
    centres = again.images.centre[order] + shift
    np.testing.assert_allclose(
        centres, np.asarray(block.exterior.projection_centre), atol=2e-5 if name in TEXT else 1e-7
    )
    if name in FULL:
        ties = _ties if name == "blocksexchange" else lambda foreign: foreign
        found, expected = residuals(ties(again)), residuals(ties(foreign_block(block)))
        np.testing.assert_allclose(found, expected, atol=1e-4 if easting else 1e-6)


def _shift(path: Path) -> np.ndarray:
    """What the writer took off the coordinates for readers in single precision."""
    files = [file for file in path.parent.rglob("*") if "shift" in file.name]
    return np.array(files[0].read_text().split()[:3], float) if files else np.zeros(3)


def test_markers_of_metashape_come_back(tmp_path):
    """Cameras, references and the rays of control, exactly; the references are in a table beside it too."""
    block = block_of("metashape")
    path = tmp_path / "out.markers.xml"
    losses = write_format(block, path, "metashape")
    assert losses == ("9 tie points and their rays",)
    again, own = read_format(path, "metashape"), foreign_block(block)
    assert again.images.names == own.images.names and again.points.names == ("K 1", "K 2", "K 3")
    np.testing.assert_allclose(again.images.centre, own.images.centre, atol=1e-12)
    np.testing.assert_allclose(again.images.rotation, own.images.rotation, atol=1e-12)
    assert {row.name: row for row in again.control} == {row.name: row for row in own.control}
    marked = np.array([own.points.names[k].startswith("K") for k in own.rays.point])
    np.testing.assert_allclose(sorted(again.rays.xy.tolist()), sorted(own.rays.xy[marked].tolist()), atol=1e-9)
    for name, value in own.cameras[0].elements.items():
        assert element(again.cameras[0], name) == pytest.approx(value, rel=1e-12), name
    rows = (tmp_path / "out.markers-reference.csv").read_text().splitlines()
    assert rows[0] == "#Label,X,Y,Z,sX,sY,sZ,Enabled" and len(rows) == 4 and rows[3].startswith("K 3,")


def test_orima_with_a_table_of_exterior_elements(tmp_path):
    """Rows in mm and the table that `exterior` writes give the block again; what is missing is asked for."""
    block = block_of("free")
    write_format(block, tmp_path / "a.csv", "exterior")
    own = foreign_block(block)
    mm = (own.rays.xy - [2000.0, 1500.0]) * [0.005, -0.005]
    rows = [
        f"{own.images.names[i]} {own.points.names[p].replace(' ', '_')} {x:.9f} {y:.9f} 0 M"
        for i, p, (x, y) in zip(own.rays.image, own.rays.point, mm.tolist(), strict=True)
    ]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(rows) + "\n")
    assert [form.name for form in recognised(path)] == ["orima"]
    with pytest.raises(BlockError, match="and no camera; give --interior F,X0,Y0 in px, --image-size W,H and"):
        read(path)
    again = read_format(path, "orima", ReadOptions((4000, 3000), (3000.0, 2010.0, 1490.0), 0.005))
    found = residuals(with_intersections(again))
    np.testing.assert_allclose(found, residuals(_intersected(block)), atol=1e-4)
    (tmp_path / "a.csv").unlink()
    with pytest.raises(BlockError, match="no orientations; add a.csv: filename,x,y,z,omega,phi,kappa,camera"):
        read(path)


def test_a_database_of_colmap_is_refused_by_name(tmp_path):
    database = sqlite3.connect(tmp_path / "database.db")
    database.execute("CREATE TABLE two_view_geometries (pair_id INTEGER)")
    database.commit()
    database.close()
    with pytest.raises(BlockError, match="is a database of COLMAP, .* orientations; run the mapper of COLMAP on it"):
        read(tmp_path / "database.db")


def test_what_is_lost_is_said(tmp_path):
    block = block_of("free")
    assert write_format(block, tmp_path / "colmap", "colmap") == ("2 rows of control", "1 check point")
    assert write_format(block, tmp_path / "b.xml", "blocksexchange") == ()
    held = dataclasses.replace(
        made("free", NAMES, np.zeros(3)), control=(Known("K 1", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)),)
    )
    assert write_format(assembled(held), tmp_path / "held", "opensfm") == ("that 1 control point is fixed",)
    with pytest.raises(ValueError, match="format 'las' is not written; known: colmap, colmap-text"):
        write_format(block, tmp_path / "x", "las")


def test_exterior_elements_as_a_table(tmp_path):
    block = block_of("free")
    write_format(block, tmp_path / "eo.csv", "exterior")
    header, first, *_ = (tmp_path / "eo.csv").read_text().splitlines()
    assert header == "filename,x,y,z,omega,phi,kappa,camera"
    angles = np.degrees(np.asarray(block.exterior.angles)[0])
    np.testing.assert_allclose(np.array(first.split(",")[4:7], float), angles, rtol=1e-12)
