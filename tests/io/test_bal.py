import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.bal_file import TINY
from cases.small_folder import make_small_folder

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError
from jaxbundle.block.residuals import observations_of, ray_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA
from jaxbundle.io import read, read_bal, read_block_folder, write_bal, write_block_folder

FILES = ("problem-49-7776-pre.txt", "ladybug-49-shrink-1800.txt", "dubrovnik-3-7-pre.txt")


def cost(block: Block) -> float:
    """Half the sum of squared residuals."""
    return float(0.5 * (ray_residuals(unknowns_of(block), observations_of(block)) ** 2).sum())


@pytest.mark.parametrize("name", FILES)
def test_initial_costs(shared_data: Path, tmp_path: Path, name: str) -> None:
    """As published, and again after writing and reading."""
    expected = json.loads((shared_data / "bal" / "expected.json").read_text())["files"][name]
    block = read(shared_data / "bal" / name)
    assert len(block.structure.image_names) == len(block.structure.cameras) == expected["cameras"]
    assert len(block.structure.point_names) == expected["points"]
    assert block.n_observations == 2 * expected["observations"]
    assert cost(block) == pytest.approx(expected["initial_cost"], rel=1e-12)
    write_bal(block, tmp_path / name)
    again = read_bal(tmp_path / name)
    assert cost(again) == pytest.approx(expected["initial_cost"], rel=1e-12)
    np.testing.assert_array_equal(again.rays.coordinates, block.rays.coordinates)
    np.testing.assert_array_equal(again.object_points, block.object_points)
    np.testing.assert_array_equal(again.interior.elements, block.interior.elements)
    np.testing.assert_allclose(again.exterior.angles, block.exterior.angles, atol=1e-14)
    np.testing.assert_allclose(again.exterior.projection_centre, block.exterior.projection_centre, atol=1e-13)
    np.testing.assert_array_equal(again.structure.ray_image, block.structure.ray_image)
    np.testing.assert_array_equal(again.structure.ray_point, block.structure.ray_point)


def test_as_block_folder(shared_data: Path, tmp_path: Path) -> None:
    block = read_bal(shared_data / "bal" / "ladybug-49-shrink-1800.txt")
    write_block_folder(block, tmp_path)
    again = read_block_folder(tmp_path)
    assert cost(again) == pytest.approx(cost(block), rel=1e-12)
    assert again.structure.n_unknowns == block.structure.n_unknowns


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.txt"
    path.write_text(TINY)
    return path


def test_tiny(tiny: Path) -> None:
    """p = R X + t, y up, the camera looks along -z: the residuals by plain matrices."""
    block = read_bal(tiny)
    x, y, z = 1e-2, 2e-2, -3e-3
    angle = np.sqrt(x * x + y * y + z * z)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * skew @ skew
    p = matrix @ [1, 2, -30] + [1, 2, -3]
    projected = -p[:2] / p[2]
    r2 = projected @ projected
    expected = 1400 * (1 + 1e-3 * r2 - 2e-4 * r2 * r2) * projected - [-385.99, 387.12]
    residuals = np.asarray(ray_residuals(unknowns_of(block), observations_of(block)))
    np.testing.assert_allclose(residuals[:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(block.exterior.projection_centre[0], -matrix.T @ [1, 2, -3], rtol=1e-13)
    assert block.structure.image_names == block.structure.point_names == ("0", "1")
    assert block.structure.name == "tiny"
    np.testing.assert_array_equal(block.rays.sigmas, 1.0)
    assert block.structure.n_unknowns == 2 * 9 + 2 * 3
    assert read_bal(tiny, estimate_interior=False).structure.n_unknowns == 2 * 6 + 2 * 3


def test_any_rotation_system_is_written(tiny: Path) -> None:
    block = read_bal(tiny)
    angles = jnp.stack(ALPHA_OMEGA_KAPPA.angles_from_rotation(tuple(unknowns_of(block).rotation)), 1)
    turned = dataclasses.replace(block.structure, rotation_system=ALPHA_OMEGA_KAPPA)
    write_bal(eqx.tree_at(lambda b: b.exterior.angles, dataclasses.replace(block, structure=turned), angles), tiny)
    assert cost(read_bal(tiny)) == pytest.approx(cost(block), rel=1e-12)


def test_other_cameras_are_not_written(tmp_path: Path) -> None:
    block = read_block_folder(make_small_folder(tmp_path / "small"))
    with pytest.raises(BlockError, match="camera wide has the model 'none'; BAL files support the model 'bal' only"):
        write_bal(block, tmp_path / "small.txt")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("2 2 4\n", "2 2\n", "1: the first line does not give the numbers of cameras, points and observations; begin"),
        ("2 2 4\n", "2 0 4\n", "1: 2 cameras, 0 points and 4 observations are not a block; give at least one of each"),
        (
            "-4 5 -36\n",
            "",
            "19: 2 cameras, 2 points and 4 observations need 43 numbers, the file has 40; the file is truncated",
        ),
        (
            "-4 5 -36\n",
            "-4 5 -36 8\n",
            "20: 2 cameras, 2 points and 4 observations need 43 numbers, the file has 44; corr",
        ),
        ("1 0     -3.84", "1 0     3 -3.84", "3: observation '1 0 3 -3.844000e+01 4.921200e+02' has 5 numbers, not 4;"),
        (
            "1 1 5.597500e+02 ",
            "1 1 ",
            "5: observation '1 1 -1.061500e+02' has 3 numbers, not 4; correct it, or download",
        ),
        ("-0.2\n", "-0.2x\n", "12: '-0.2x' is not a finite number; correct it, or download the file again"),
        ("-0.2\n", "nan\n", "12: 'nan' is not a finite number; correct it"),
        ("1 0     -3", "2 0     -3", "3: there is no camera 2: the file has 2, numbered from 0; correct the number"),
        ("1 1 5", "1 -1 5", "5: there is no point -1: the file has 2, numbered from 0; correct the number"),
        ("1400 1e-3", "0 1e-3", "9: 0 is not from 1e-06 to 1e+09 in size, as f is; correct it, or download the file"),
        (
            "1e-2 2e-2",
            "1e308 2e-2",
            "7: 1e+308 is not from 0 to 628.319 in size, as a rotation vector, rad is; correct",
        ),
        ("1 2 -30", "1e99 2e99 -30", "19: 1e+99 is not from 0 to 1e+12 in size, as a coordinate is, and 1 more number"),
        ("1 1 5", "0.5 1 5", "5: there is no camera 0.5: the file has 2, numbered from 0; correct the number"),
    ],
)
def test_broken_files(tiny: Path, old: str, new: str, expected: str) -> None:
    assert old in TINY
    tiny.write_text(TINY.replace(old, new, 1))
    with pytest.raises(BlockError) as caught:
        read_bal(tiny)
    (line,) = caught.value.lines
    assert line.startswith(f"tiny.txt:{expected}"), line
