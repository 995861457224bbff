"""The cache of compiled programs: where it is, who switches it off, and that a process in Python has it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxbundle.numerics.program_cache import OFF, SWITCH, cache_folder

ROOT = Path(__file__).parents[2]


def test_cache_is_in_the_users_cache_folder(monkeypatch, tmp_path):
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "jaxbundle"
    for given in ("", "relative"):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert cache_folder() == Path.home() / ".cache" / "jaxbundle"
    monkeypatch.setenv("HOME", "relative")
    assert cache_folder() is None

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert cache_folder() is None


def test_the_variable_names_the_folder_or_switches_the_cache_off(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for given, folder in ((str(tmp_path), tmp_path), ("relative", tmp_path / "cache" / "jaxbundle"), (OFF, None)):
        monkeypatch.setenv(SWITCH, given)
        assert cache_folder() == folder


# a function of the package that compiles a small program by JAX, and the settings that it leaves
SCRIPT = """
import sys, jax
jax.config.update("jax_enable_x64", True)
for setting, value in zip(sys.argv[1::2], sys.argv[2::2]): jax.config.update(setting, value)
import jaxbundle as jb
jb.orientation.three_point_resection([[0, 0, 0], [90, 0, 5], [0, 99, 0]], [[-3, -4, -20], [7, -4, -20], [-3, 6, -19]])
print(jax.config.jax_compilation_cache_dir)
"""


def process(tmp_path: Path, *settings: str, **variables: str) -> tuple[str, int]:
    """The cache folder of JAX in a new process, and the number of files in the cache of the user."""
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)} | variables
    command = [sys.executable, "-W", "error", "-c", SCRIPT, *settings]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip(), sum(path.is_file() for path in tmp_path.rglob("*"))


def test_a_process_in_python_keeps_its_programs(tmp_path):
    folder, files = process(tmp_path)
    assert Path(folder).is_relative_to(tmp_path / "jaxbundle" / "jax") and files > 0


@pytest.mark.parametrize("case", ["off", "open", "own"])
def test_a_process_keeps_nothing_against_its_user(tmp_path, case):
    own = tmp_path / "own"
    if case == "open":
        (tmp_path / "jaxbundle").mkdir()
        (tmp_path / "jaxbundle").chmod(0o777)
    folder, files = {
        "off": lambda: process(tmp_path, **{SWITCH: OFF}),
        "open": lambda: process(tmp_path),
        "own": lambda: process(tmp_path, "jax_compilation_cache_dir", str(own)),
    }[case]()
    assert folder == (str(own) if case == "own" else "None")
    assert not [path for path in (tmp_path / "jaxbundle").rglob("*") if path.is_file()]
