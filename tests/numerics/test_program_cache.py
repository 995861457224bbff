"""The cache of compiled programs: where it is, who switches it off, and that a process in Python has it."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from jaxbundle.numerics import programs
from jaxbundle.numerics.program_cache import OFF, SWITCH, cache_folder, keep_programs

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


# a function of the package that compiles a small program by JAX, and the setting that it leaves
SCRIPT = """
import jax
jax.config.update("jax_enable_x64", True)
import jaxbundle as jb
jb.orientation.three_point_resection([[0, 0, 0], [90, 0, 5], [0, 99, 0]], [[-3, -4, -20], [7, -4, -20], [-3, 6, -19]])
print(jax.config.jax_compilation_cache_dir)
"""


def test_a_process_in_python_keeps_its_programs(tmp_path):
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", "-c", SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "jaxbundle" / "jax")
    assert any(path.is_file() for path in tmp_path.rglob("*"))


SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


@pytest.fixture
def new_process(monkeypatch, tmp_path):
    """The settings of a new process, and a home of its own; those of the tests come back afterwards."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setattr(programs, "_kept_in", [])
    before = {name: programs.setting(name) for name in SETTINGS}
    jax.config.update(SETTINGS[0], None)
    yield
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.parametrize("case", ["off", "open", "own", "neither"])
def test_a_process_keeps_nothing_against_its_user(new_process, monkeypatch, tmp_path, case):
    """Nowhere if it is switched off or if others may write to the folder; what JAX keeps stays where the user wants."""
    own = tmp_path / "own"
    if case == "off":
        monkeypatch.setenv(SWITCH, OFF)
    elif case == "open":
        (tmp_path / "jaxbundle").mkdir()
        (tmp_path / "jaxbundle").chmod(0o777)
    elif case == "own":
        jax.config.update(SETTINGS[0], str(own))
    keep_programs.__wrapped__()
    kept = programs.setting(SETTINGS[0])
    if case == "neither":
        assert Path(kept).is_relative_to(tmp_path / "jaxbundle") and programs.chosen_folder() is not None
    else:
        assert kept == (str(own) if case == "own" else None)
        assert programs.chosen_folder() is None or case == "own"
    assert not [path for path in (tmp_path / "jaxbundle").rglob("*") if path.is_file()]
