"""What a path may mean: a block folder, its block.toml, a BAL file, or a known form that is not read."""

from pathlib import Path

import pytest
from cases.bal_file import TINY
from cases.same_block import assert_same
from cases.small_folder import make_small_folder

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read


def test_block_toml_means_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_small_folder(tmp_path / "small")
    assert_same(read(folder / "block.toml"), read(folder))
    monkeypatch.chdir(folder)
    assert_same(read("block.toml"), read(str(folder)))


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_bal_lines_may_end_in_any_way(tmp_path: Path, ends: str, mark: bytes) -> None:
    path = tmp_path / "tiny.txt"
    path.write_bytes(mark + TINY.replace("\n", ends).encode())
    assert len(read(path).structure.ray_point) == 4
    path.write_bytes(mark + TINY.replace("-0.2\n", "x\n").replace("\n", ends).encode())
    assert told(path).startswith("tiny.txt:12: 'x' is not a finite number")


def told(path: Path) -> str:
    with pytest.raises(BlockError) as caught:
        read(path)
    (line,) = caught.value.lines
    return line


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("colmap/txt/images.txt", "is a file of a COLMAP model; give the folder"),
        ("exchange/colmap/sceaux_rigs_frames", "has no block.toml; give a folder with block.toml, a BAL text file, or"),
        ("exchange/las/simple.laz", "is a point cloud (LAZ), which is not read"),
        ("exchange/exif/DJI_0018_header.jpg", "is a picture (JPEG), which is not read"),
        ("strasbourg-s4-tie/rays.csv", "is a file of the block folder"),
    ],
)
def test_known_forms_are_named(shared_data: Path, path: str, what: str) -> None:
    assert what in told(shared_data / path)


def test_what_is_nothing(tmp_path: Path) -> None:
    assert "does not exist; give a folder with block.toml, a BAL text file, or one of: colmap" in told(
        tmp_path / "nowhere"
    )
    assert "cannot be read: File name too long" in told(tmp_path / ("a" * 300))
    assert "has no block.toml" in told(tmp_path)
    (tmp_path / "a" / "b").mkdir(parents=True)
    make_small_folder(tmp_path / "a" / "b")
    assert "has no block.toml; give one of its folders: b" in told(tmp_path / "a")
    (tmp_path / "a" / "b" / "block.toml").unlink()
    assert "has tables but no block.toml; write block.toml" in told(tmp_path / "a" / "b")
    (tmp_path / "bal.gz").write_bytes(b"\x1f\x8b\x08")
    assert "bal.gz is compressed (gzip), which is not read" in told(tmp_path / "bal.gz")
