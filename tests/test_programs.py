"""Compiled programs kept on disk: found again, made again where the file is no good, never kept for foreign sources."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.block.unknowns import _compiled_rotations
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics import programs
from jaxbundle.numerics.compilation import Compiled

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


def test_foreign_function_is_not_kept(folder):
    rotations(lambda system, angles: jnp.stack(system.rotation_from_angles(*angles)))
    assert not list(folder.iterdir())


def test_foreign_part_of_an_argument_is_not_kept(folder):
    def turned(*angles):
        return OMEGA_PHI_KAPPA.rotation_from_angles(*angles)

    class Foreign:
        rotation_from_angles = staticmethod(turned)

    compiled = Compiled(_compiled_rotations.function)
    compiled(Foreign(), ANGLES, optimised=False)
    assert not list(folder.iterdir())


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
