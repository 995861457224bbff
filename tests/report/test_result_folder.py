"""A folder of results: where it can be, that it is replaced as a whole, and that nothing of others is lost."""

import errno
import json
import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from jaxbundle.numerics import whole_files
from jaxbundle.numerics.whole_files import marked_name, remnants
from jaxbundle.report import result_folder
from jaxbundle.report.result_folder import replaced, require_writable, tidy

ROOT = Path(__file__).parents[2]
NAMES = ["points.csv", "report.json", "report.txt"]
posix = pytest.mark.skipif(os.name != "posix", reason="folders as POSIX has them")


def write(target: Path, content: str, names: list[str] = NAMES) -> None:
    require_writable(target, names, 1000)
    with replaced(target, names) as place:
        for name in names:
            (place / name).write_text(json.dumps({"files": names}) if name == "report.json" else content)


@posix
@pytest.mark.parametrize("where", ["beside", "inside"])
def test_killed_or_interrupted_at_every_step(tmp_path, where):
    worker = Path(__file__).with_name("killed_writer.py")
    command = [sys.executable, worker, tmp_path, where]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 60


@posix
def test_the_place_is_tried_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for target, words in (
        (tmp_path / "file", "is a file; give a folder"),
        (tmp_path / "file" / "below", "is a file, so the folder .* cannot be created below it; give another folder"),
        (tmp_path / "dangling", "is a link to .*nowhere, which does not exist; give another folder"),
        (tmp_path / ("x" * 300), "File name too long|the name is too long"),
    ):
        with pytest.raises(OSError, match=words):
            require_writable(target, NAMES, 1000)
    for code, words in (
        (errno.EROFS, "the file system is read-only"),
        (errno.EACCES, "no permission to write there"),
        (errno.ENOSPC, "no space is left there"),
    ):

        def refused(*_, code=code):
            raise OSError(code, os.strerror(code))

        with monkeypatch.context() as patched:
            patched.setattr(result_folder, "sync_file", refused)
            with pytest.raises(OSError, match=f"{tmp_path}/new: {words}; give another folder for the results"):
                require_writable(tmp_path / "new", NAMES, 1000)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dangling", "file"]


def test_space_is_looked_at_before_the_work(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(result_folder.shutil, "disk_usage", lambda _: usage(10**9, 10**9, 2_000_000))
    require_writable(tmp_path / "new", NAMES, 1_000_000)
    with pytest.raises(OSError, match="the results need about 3 MB, but 2 MB are free in .*; give another folder"):
        require_writable(tmp_path / "new", NAMES, 3_000_000)


def test_what_others_put_there_moves_over(tmp_path):
    target = tmp_path / "results"
    write(target, "old", [*NAMES, "check_points.csv"])
    target.chmod(0o750)
    (target / "notes").mkdir()
    (target / "notes" / "a.txt").write_text("mine")
    (target / "link").symlink_to("nowhere")
    write(target, "new")
    assert (target / "points.csv").read_text() == "new" and not (target / "check_points.csv").exists()
    assert (target / "notes" / "a.txt").read_text() == "mine" and (target / "link").is_symlink()
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
    assert os.name != "posix" or target.stat().st_mode & 0o777 == 0o750


@posix
def test_a_link_to_a_folder_stays_a_link(tmp_path):
    write(tmp_path / "results", "old")
    (tmp_path / "link").symlink_to("results")
    write(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "results" / "points.csv").read_text() == "new"


@posix
def test_without_an_exchange_of_names(tmp_path, monkeypatch):
    monkeypatch.setattr(result_folder.ctypes, "CDLL", lambda *_, **__: object())
    write(tmp_path / "results", "old")
    (tmp_path / "results" / "mine").touch()
    write(tmp_path / "results", "new")
    assert (tmp_path / "results" / "points.csv").read_text() == "new" and (tmp_path / "results" / "mine").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


@pytest.mark.parametrize(
    "garbage", ["[" * 5_000_000, "", "{}", '{"files": 3}', '{"files": ["sub", "../x", 7]}', "\xff"]
)
def test_an_earlier_report_of_garbage(tmp_path, garbage):
    (tmp_path / "sub").mkdir()
    (tmp_path / "report.json").write_text(garbage, encoding="latin-1")
    with pytest.raises(FileExistsError, match="report.json, which no adjustment wrote; give another folder"):
        write(tmp_path, "new")
    assert {path.name for path in tmp_path.iterdir()} == {"sub", "report.json"}


def test_a_folder_in_the_list_of_files_is_not_ours(tmp_path):
    write(tmp_path / "results", "old")
    (tmp_path / "results" / "sub.csv").mkdir()
    names = json.dumps({"files": [*NAMES, "sub.csv"]})
    (tmp_path / "results" / "report.json").write_text(names)
    write(tmp_path / "results", "new")
    assert (tmp_path / "results" / "sub.csv").is_dir()


@posix
def test_remnants_are_told_from_what_is_being_written(tmp_path, monkeypatch):
    mark = marked_name()
    machine, process, start, rest = mark.removeprefix(whole_files.PREFIX).split("-")
    ended = f"{whole_files.PREFIX}{machine}-{process}-{int(start) + 1}-{rest}"
    elsewhere = f"{whole_files.PREFIX}{'0' * 8}-{process}-{start}-{rest}"
    for name in (mark, ended, elsewhere, ".jaxbundle-mine", "notes"):
        (tmp_path / name).mkdir()
    assert remnants(tmp_path) == [tmp_path / ended]
    os.utime(tmp_path / elsewhere, (1e9, 1e9))
    assert remnants(tmp_path) == sorted([tmp_path / ended, tmp_path / elsewhere])
    tidy(tmp_path / "results")
    assert {path.name for path in tmp_path.iterdir()} == {mark, ".jaxbundle-mine", "notes"}
    with monkeypatch.context() as patched:
        patched.setattr(os, "geteuid", lambda: os.getuid() + 1)
        (tmp_path / ended).mkdir()
        assert not remnants(tmp_path)  # of another user


def test_two_writers_at_once(tmp_path):
    target = tmp_path / "results"
    with replaced(target, NAMES) as first, replaced(target, [*NAMES, "rays.csv"]) as second:
        for place, names in ((first, NAMES), (second, [*NAMES, "rays.csv"])):
            for name in names:
                (place / name).write_text(json.dumps({"files": names}))
    assert {path.name for path in target.iterdir()} == set(NAMES)
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
