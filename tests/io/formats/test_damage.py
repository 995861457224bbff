"""Broken files of other programs: each ends in one BlockError with place and cure, never in a traceback."""

import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from cases.mutated_files import bytes_changed
from cases.rosetta import PLACES

from jaxbundle.block.problems import BlockError
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.colmap import read_colmap
from jaxbundle.io.formats.foreign_block import DEFAULT
from jaxbundle.io.formats.format_table import FORMATS, read_format, recognised
from jaxbundle.io.formats.metashape import read_metashape
from jaxbundle.io.formats.nvm import read_nvm
from jaxbundle.io.formats.opensfm import read_opensfm
from jaxbundle.io.reading import read


def told(read_it, path: Path) -> str:
    with pytest.raises(BlockError) as caught:
        read_it(path, DEFAULT)
    assert caught.value.lines and all(line for line in caught.value.lines)
    return "\n".join(caught.value.lines)


def copied(shared_data: Path, place: str, folder: Path) -> Path:
    """A copy of a sample that can be broken."""
    source = shared_data / "exchange" / place
    target = folder / source.name
    shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
    return target


@pytest.fixture(scope="module")
def rig(shared_data):
    """The binary files of a small COLMAP model."""
    folder = shared_data / "exchange" / "colmap" / "rig2_synthetic" / "bin"
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def put(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"])
def test_cut_binary_files_are_told_with_their_byte(tmp_path, rig, name):
    data = rig[name]
    cuts = [*range(0, min(len(data), 120), 4), *range(120, len(data), max(len(data) // 40, 1))]
    for cut in cuts:
        words = told(read_colmap, put(tmp_path / "model", {**rig, name: data[:cut]}))
        assert words.startswith(f"{name}: ") and "truncated or damaged" in words, (cut, words)
    words = told(read_colmap, put(tmp_path / "model", {**rig, name: data + b"x"}))
    assert "1 bytes follow the last record" in words


def test_wrong_numbers_of_binary_files(tmp_path, rig):
    data = rig["cameras.bin"]
    unknown = data[:12] + struct.pack("<i", 99) + data[16:]
    assert "camera 1 has the unknown model 99" in told(
        read_colmap, put(tmp_path / "a", {**rig, "cameras.bin": unknown})
    )
    panorama = struct.pack("<Q", 1) + struct.pack("<IiQQ2d", 1, 17, 100, 50, 100.0, 50.0)
    words = told(read_colmap, put(tmp_path / "b", {**rig, "cameras.bin": panorama}))
    assert "camera 1 has the model EQUIRECTANGULAR; read are SIMPLE_PINHOLE" in words
    many = struct.pack("<Q", 2**60) + data[8:]
    assert "more than the rest of the file can contain" in told(
        read_colmap, put(tmp_path / "c", {**rig, "cameras.bin": many})
    )
    nan = data[:32] + struct.pack("<d", np.nan) + data[40:]
    words = told(read_colmap, put(tmp_path / "d", {**rig, "cameras.bin": nan}))
    assert "camera 1 has a parameter that is not a finite number" in words


def test_all_problems_of_text_files_are_told(tmp_path, shared_data):
    folder = copied(shared_data, "colmap/rig2_synthetic/txt", tmp_path)
    (folder / "cameras.txt").write_text("1 OPENCV 10 x 1 2\n2 CURVED 10 10 1 2\n")
    (folder / "points3D.txt").write_text("1 0 0 zero 1 1 1 0\n")
    words = told(read_colmap, folder)
    assert "cameras.txt:1: the field 'x' is not a whole number" in words
    assert "points3D.txt:1: 'zero' is not a finite number" in words


def test_stale_poses_give_way_to_frames(tmp_path, rig):
    """COLMAP 4.2 writes poses of images that contradict rigs and frames."""
    at = 8 + 4  # behind the number of images and the first number
    stale = rig["images.bin"][:at] + struct.pack("<7d", 1, 0, 0, 0, 0, 0, 0) + rig["images.bin"][at + 56 :]
    found = read_colmap(put(tmp_path / "model", {**rig, "images.bin": stale}))
    right = read_colmap(put(tmp_path / "right", rig))
    np.testing.assert_allclose(found.images.centre, right.images.centre, atol=1e-12)
    assert "the poses of 1 images differ from the poses of their rigs and frames" in found.findings[0].words


def test_empty_second_lines_and_names_with_blanks(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 100 100 90 90 50 50\n")
    (tmp_path / "images.txt").write_text(
        "1 1 0 0 0 0 0 5 1 a b.jpg\n\n2 1 -0 0 0 1 0 5 1 left/c.jpg\n10 20 7 11 21 -1\n"
    )
    (tmp_path / "points3D.txt").write_text("7 0 0 0 1 2 3 -1 2 0\n")
    found = read_colmap(tmp_path)
    assert found.images.names == ("a b.jpg", "left/c.jpg") and found.rays.image.tolist() == [1]


def test_opensfm_tells_places(tmp_path, shared_data):
    folder = copied(shared_data, "opensfm", tmp_path)
    content = json.loads((folder / "reconstruction.json").read_text())
    camera = next(iter(content[0]["cameras"].values()))
    camera["projection_type"] = "fisheye"
    (folder / "reconstruction.json").write_text(json.dumps(content))
    assert "has the projection fisheye; read are perspective, brown" in told(read_opensfm, folder)
    camera["width"] = "wide"
    (folder / "reconstruction.json").write_text(json.dumps(content))
    assert "Input should be a valid integer" in told(read_opensfm, folder)
    (folder / "reconstruction.json").write_text("[\n{")
    assert "reconstruction.json:2: this is not JSON" in told(read_opensfm, folder)
    (folder / "tracks.csv").unlink()
    shutil.copy(shared_data / "exchange" / "opensfm" / "reconstruction.json", folder)
    assert "tracks.csv is missing in the folder of reconstruction.json" in told(read_opensfm, folder)


def test_document_types_are_refused(tmp_path):
    path = tmp_path / "b.xml"
    path.write_text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><BlocksExchange></BlocksExchange>')
    assert "the file has a document type (<!DOCTYPE), which is not read" in told(FORMATS["blocksexchange"].read, path)
    path.write_text("<BlocksExchange><Block>")
    assert "b.xml:1: this is not XML that can be read" in told(FORMATS["blocksexchange"].read, path)


def test_dialects_of_nvm(tmp_path):
    """d = -k of COLMAP against d of VisualSFM: the rays decide."""
    rng = np.random.default_rng(3)
    points = np.c_[rng.uniform(-1, 3, 20), rng.uniform(-2, 2, 20), rng.uniform(8, 10, 20)]
    lines = ["NVM_V3", "", "3"]
    lines += [f"i{k}.jpg 1000 1 0 0 0 {k} 0 0 0.1 0" for k in range(3)] + ["", "20"]
    for p in points:
        rays = []
        for k in range(3):
            q = (p - [k, 0, 0])[:2] / p[2]
            u = 1000 * q * (1 - 0.1 * (q @ q)) + [500, 400]
            rays.append(f"{k} 0 {u[0]:.9f} {u[1]:.9f}")
        lines.append(f"{p[0]} {p[1]} {p[2]} 0 0 0 3 {' '.join(rays)}")
    path = tmp_path / "a.nvm"
    path.write_text("\n".join([*lines, "", "0"]))
    assert "NVM files do not have the size of the images; give it with --image-size W,H" in told(read_nvm, path)
    block = assembled(read_nvm(path, DEFAULT._replace(image_size=(1000, 800))))
    words = " ".join(finding.words for finding in block.structure.findings)
    assert "read with -d as a distortion of the projection, which fits best" in words
    assert [form.name for form in recognised(path)] == ["nvm"]


def test_metashape_without_tie_points_says_what_to_do(tmp_path, shared_data):
    folder = copied(shared_data, "metashape/sxb", tmp_path)
    for path in folder.glob("*.ply"):
        path.unlink()
    text = (folder / "doc.xml").read_text()
    (folder / "doc.xml").write_text(text[: text.index("<markers")] + text[text.index("</markers>") + 10 :])
    assert "neither tie points nor measured markers; Metashape packs the tie points" in told(read_metashape, folder)


def test_several_formats_are_told(tmp_path, shared_data):
    folder = copied(shared_data, "bingo", tmp_path)
    for path in (shared_data / "exchange" / "patb").glob("sxb.*"):
        shutil.copy(path, folder)
    with pytest.raises(BlockError, match="choose one with --format, one of: bingo, patb"):
        read(folder)


def small(path: Path) -> list[Path]:
    """The files of a sample that can be made wrong."""
    return [path] if path.is_file() else sorted(file for file in path.iterdir() if file.name != "SOURCE.txt")


@pytest.mark.parametrize("name", [*PLACES, "colmap", "opensfm", "micmac"])
def test_random_damage(tmp_path, shared_data, name):
    """Whatever bytes are changed: a block or a BlockError."""
    place = {**PLACES, "colmap": "colmap/rig2_synthetic/txt", "opensfm": "opensfm", "micmac": "micmac/Ori-Rel"}[name]
    path = copied(shared_data, place, tmp_path)
    files = small(path)
    whole = {file: file.read_bytes() for file in files}
    ends = set()
    for seed in range(8):
        rng = np.random.default_rng([seed, len(name)])
        file = files[int(rng.integers(len(files)))]
        file.write_bytes(bytes_changed(whole[file], rng))
        try:
            foreign = read_format(path, name)
            assert foreign.images.names is not None
            ends.add("read")
        except BlockError as error:
            assert error.lines
            ends.add("told")
        file.write_bytes(whole[file])
    assert ends <= {"read", "told"}
