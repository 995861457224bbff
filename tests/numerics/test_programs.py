"""Compiled programs kept on disk: found again, made again where the file is no good, never kept for foreign sources."""

import json
import os
import pickle
import sys
import zlib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.block.unknowns import _compiled_rotations
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.model import mixture
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics import programs
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.private_folder import private_folder, trim

ANGLES = jnp.array([[0.1, 0.2], [0.3, -0.4], [-0.5, 0.6]])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "folder", lambda: tmp_path)
    return tmp_path


def rotations(function) -> np.ndarray:
    return np.asarray(Compiled(function)(OMEGA_PHI_KAPPA, ANGLES, optimised=False))


def test_second_process_neither_traces_nor_compiles(folder, monkeypatch):
    function = _compiled_rotations.function
    first = rotations(function)
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr(RotationSystem, "rotation_from_angles", None)
    np.testing.assert_array_equal(rotations(function), first)


def test_spoilt_file_is_made_again(folder):
    first = rotations(_compiled_rotations.function)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    np.testing.assert_array_equal(rotations(_compiled_rotations.function), first)
    assert len(file.read_bytes()) > len(whole) // 2


def spoil(data: bytes, how: str) -> bytes:
    """A file of a program with one thing wrong."""
    head, _, body = data.partition(b"\n")
    header = json.loads(head)
    if how == "planted":
        body = zlib.compress(pickle.dumps(Planted()))
    elif how == "bomb":
        body = zlib.compress(bytes(10_000_000))
    elif how == "one bit":
        body = body[:100] + bytes([body[100] ^ 1]) + body[101:]
    elif how in header:
        header[how] = {"name": "other", "arrays": [[[2, 2], "float64"]], "devices": 99, "size": 10**18}[how]
    return {"empty": b"", "random": b"{[" * 100_000}.get(how, json.dumps(header).encode() + b"\n" + body)


class Planted:
    """What ends a process that unpickles it."""

    def __reduce__(self):
        return sys.exit, (7,)


@pytest.mark.parametrize("how", ["planted", "bomb", "one bit", "name", "arrays", "devices", "size", "empty", "random"])
def test_file_that_does_not_match_is_ignored(folder, how):
    first = rotations(_compiled_rotations.function)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    assert programs.load(file, [ANGLES]) is not None
    file.write_bytes(spoil(whole, how))
    assert programs.load(file, [ANGLES]) is None
    np.testing.assert_array_equal(rotations(_compiled_rotations.function), first)


posix = pytest.mark.skipif(os.name != "posix", reason="permissions as POSIX has them")


@posix
def test_only_what_the_user_alone_may_write_is_read(folder, monkeypatch):
    rotations(_compiled_rotations.function)
    (file,) = folder.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o620)
    assert programs.load(file, [ANGLES]) is None
    file.chmod(0o600)
    link = folder / "link" / file.name
    link.parent.mkdir()
    link.symlink_to(file)
    assert programs.load(link, [ANGLES]) is None
    assert programs.load(file, [ANGLES]) is not None
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert programs.load(file, [ANGLES]) is None


@posix
def test_private_folders(tmp_path, monkeypatch):
    made = private_folder(tmp_path / "a" / "b")
    assert made is not None and made == tmp_path / "a" / "b"
    assert made.stat().st_mode & 0o777 == made.parent.stat().st_mode & 0o777 == 0o700
    made.chmod(0o770)
    assert private_folder(made) is None
    made.chmod(0o755)
    assert private_folder(made) == made
    (tmp_path / "link").symlink_to(made)
    assert private_folder(tmp_path / "link") is None
    (tmp_path / "file").touch()
    assert private_folder(tmp_path / "file") is None and private_folder(tmp_path / "file" / "below") is None
    monkeypatch.setattr(os, "geteuid", lambda: tmp_path.stat().st_uid + 1)
    assert private_folder(made) is None
    if tmp_path.stat().st_uid:  # in a folder of another user nothing is made; one of root may be everybody's
        assert private_folder(tmp_path / "new") is None and not (tmp_path / "new").exists()


@posix
def test_a_folder_of_others_keeps_nothing(tmp_path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    before = programs.folder()
    programs.keep_in(tmp_path / "open")
    assert programs.folder() is None
    programs.keep_in(tmp_path / "own")
    assert programs.folder() == tmp_path / "own"
    if before is not None:
        programs.keep_in(before)


def test_cache_is_trimmed(tmp_path):
    for age, name in enumerate(("new", "older", "oldest")):
        file: Path = tmp_path / name / name
        file.parent.mkdir()
        file.write_bytes(bytes(1000))
        os.utime(file, (1e9 - age, 1e9 - age))
    trim(tmp_path, 2500)
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"new", "older"}
    trim(tmp_path, 2500)
    assert len([path for path in tmp_path.rglob("*") if path.is_file()]) == 2


def test_foreign_function_is_not_kept(folder):
    rotations(lambda system, angles: jnp.stack(system.rotation_from_angles(*angles)))
    assert not list(folder.iterdir())


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_foreign_part_of_an_argument_is_not_kept(folder):
    def turned(*angles):
        return OMEGA_PHI_KAPPA.rotation_from_angles(*angles)

    class Foreign:
        rotation_from_angles = staticmethod(turned)

    compiled = Compiled(_compiled_rotations.function)
    compiled(Foreign(), ANGLES, optimised=False)
    assert not list(folder.iterdir())


def test_a_part_made_of_the_packages_own_is_kept():
    """Cameras of two models in one block."""
    function, both = _compiled_rotations.function, mixture((BROWN, DISTORTION_FREE))
    assert programs.program_name(function, both, ANGLES, {}) is not None


def test_other_shapes_and_settings_have_other_names():
    function = _compiled_rotations.function
    names = {
        programs.program_name(function, OMEGA_PHI_KAPPA, ANGLES, {}),
        programs.program_name(function, OMEGA_PHI_KAPPA, ANGLES[:, :1], {}),
        programs.program_name(function, OMEGA_PHI_KAPPA, ANGLES.astype(jnp.float32), {}),
        programs.program_name(function, OMEGA_PHI_KAPPA, ANGLES, {"xla_backend_optimization_level": 0}),
        programs.program_name(function, None, ANGLES, {}),
    }
    assert len(names) == 5 and None not in names
