"""The mistakes people make with a block folder, each on a copy of a real block: what the reader says, once and with
its place, or finds."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Kind, Severity, of_kind
from jaxbundle.block.problems import BlockError
from jaxbundle.io import read


@pytest.fixture(scope="module")
def mistakes(shared_data: Path) -> ModuleType:
    """The functions that make the mistakes."""
    spec = importlib.util.spec_from_file_location("mistakes", shared_data / "cases" / "user_mistakes.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def made(mistakes: ModuleType, name: str, folder: Path) -> Path:
    """The folder with a mistake."""
    block = mistakes.B()
    mistakes.M[name](block)
    block.save(folder / name)
    return folder / name


# mistake: rows that the one problem concerns, file and line, and words of cause and cure
REFUSED: dict[str, tuple[int, str, tuple[str, ...]]] = {
    "a02_header_own_names": (1, "images.csv:1", ("'photo' to 'image'", "'E' to 'X0'", "'N' to 'Y0'", "'H' to 'Z0'")),
    "a10_unit_mm_values_px": (1, "block.toml:10", ("rays in mm have no pixel_size",)),
    "a13_decimal_comma_quoted": (16, "control.csv:2", ("16 rows", "'999604,58'", "decimal sign", "point")),
    "a17_latin1_umlaut": (1, "control.csv:2", ("0xfc", "UTF-8")),
    "a19_control_names_all_prefixed": (
        1,
        "control.csv:2",
        ("none of the 16 control points", "all 16 names match without 'GCP'", "317 for GCP317"),
    ),
    "a25_c_negative": (1, "block.toml:13", ("principal_distance", "greater than 0")),
    "a34_images_columns_missing": (1, "images.csv:1", ("'X0', 'Y0', 'Z0'", "approximate values")),
    "a37_image_name_ext": (
        1196,
        "rays.csv:2",
        ("1196 rows", "not in images.csv", "without '.tif'", "8811 for 8811.tif"),
    ),
    "a39_role_missing_column": (1, "control.csv:1", ("'role' is missing", "control or check")),
    "a40_sigma_columns_missing": (1, "control.csv:1", ("'sX', 'sY', 'sZ'", "0 fixes a coordinate")),
    "a41_sigma_empty": (1, "control.csv:2", ("none of the 16 control points", "sX, sY, sZ are empty", "in m")),
    "a45_only_2_control": (1, "rays.csv:8", ("point 403 is seen on one image only",)),
    "a46_no_control": (1, "rays.csv:8", ("point 403 is seen on one image only",)),
    "a52_duplicate_ray": (1, "rays.csv:1198", ("already in line 7", "drop one")),
    "a53_alpha_system_name": (1, "block.toml:7", ("'phi-omega-kappa'", "omega-phi-kappa, alpha-omega-kappa")),
    "a54_yaw_pitch_roll": (1, "block.toml:7", ("'yaw-pitch-roll'", "omega-phi-kappa, alpha-omega-kappa")),
    "a55_wrong_camera_name": (5, "images.csv:2", ("camera DMC is not in block.toml", "known: scan")),
    "a56_no_camera_column": (1, "images.csv:1", ("'camera' is missing", "of block.toml in each row")),
    "a59_object_unit_cm": (1, "block.toml:4", ('"cm"', "'m' or 'mm'")),
    "a60_toml_backslash_and_quotes": (1, "block.toml:2", ('name = "my block"',)),
    "a64_thousands_sep": (16, "control.csv:2", ("16 rows", "separators of thousands")),
    "a65_missing_block_toml": (1, "folder", ("has tables but no block.toml", "write block.toml")),
    "a66_tables_not_listed": (1, "block.toml", ("[tables] is missing", 'rays = "rays.csv"', 'control = "control.csv"')),
    "a67_control_not_listed_file_there": (  # without it point 403 has one ray, which follows and is not told
        1,
        "block.toml: control.csv is not named in [tables]",
        ('add control = "control.csv" there',),
    ),
    "a69_excel_float_names": (1, "control.csv:2", ("all 16 names match", "'.0'", "317 for 317.0")),
}
READ = ["a00_correct", "a11_semicolon", "a12_semicolon_decimal_comma", "a14_tabs", "a15_crlf_bom", "a16_utf16"] + [
    "a38_role_capital",
    "a68_spaces_in_names",
]


@pytest.mark.parametrize("name", REFUSED)
def test_one_problem(mistakes: ModuleType, tmp_path: Path, name: str) -> None:
    """One line: the place first, then the cause and the cure."""
    count, place, words = REFUSED[name]
    with pytest.raises(BlockError) as caught:
        read(made(mistakes, name, tmp_path))
    (line,), (problem,) = caught.value.lines, caught.value.problems
    assert line.startswith(place), line
    assert problem.count == count
    assert problem.cure and line.endswith(problem.cure)
    assert all(word in line for word in words), line


@pytest.fixture(scope="module")
def correct(mistakes: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Block:
    return read(made(mistakes, "a00_correct", tmp_path_factory.mktemp("correct")))


@pytest.mark.parametrize("name", READ)
def test_read_without_a_word(mistakes: ModuleType, correct: Block, tmp_path: Path, name: str) -> None:
    """The same block, and nothing to tell."""
    block = read(made(mistakes, name, tmp_path))
    assert block.structure.findings == ()
    assert (block.object_points == correct.object_points).all()
    assert (block.rays.coordinates == correct.rays.coordinates).all()
    assert (block.groups[0].values == correct.groups[0].values).all()
    assert (block.groups[0].sigmas == correct.groups[0].sigmas).all()
    assert block.structure.point_names == correct.structure.point_names


def test_camera_elements_of_another_program(mistakes: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(BlockError) as caught:
        read(made(mistakes, "a62_metashape_coeff_names", tmp_path))
    coefficients, estimate = caught.value.lines
    assert "K1 for k1" in coefficients
    assert "principal_distance for f, x0 for cx, y0 for cy, K1 for k1" in estimate


def test_leading_zeros_are_told_for_each_table(mistakes: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(BlockError) as caught:
        read(made(mistakes, "a70_leading_zero_names", tmp_path))
    approximate, control = caught.value.lines
    assert approximate.startswith("points.csv:2") and "065231 for 65231" in approximate
    assert control.startswith("control.csv:2") and "0317 for 317" in control


def test_a_slip_in_a_name_is_to_be_checked(mistakes: ModuleType, tmp_path: Path) -> None:
    """371 for 317: the block is read without the point, and the likely name is told."""
    (finding,) = read(made(mistakes, "a18_control_name_typo", tmp_path)).structure.findings
    assert (finding.kind, finding.severity) == (Kind.UNUSED, Severity.CHECK)
    assert finding.subjects[0].table == "control" and finding.subjects[0].names == ("371",)
    assert "317 for 371" in finding.cure


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("a19_control_names_all_prefixed", "317 for GCP317"),
        ("a41_sigma_empty", "0 fixes a coordinate"),
        ("a67_control_not_listed_file_there", 'control = "control.csv"'),
        ("a69_excel_float_names", "317 for 317.0"),
        ("a70_leading_zero_names", "0317 for 317"),
    ],
)
def test_control_that_is_not_used_fails(mistakes: ModuleType, tmp_path: Path, name: str, cure: str) -> None:
    """Also where the block could be adjusted without it: point 403, which is on one image, is left out here."""
    folder = made(mistakes, name, tmp_path)
    rays = folder / "rays.csv"
    rows = [row for row in rays.read_text().splitlines() if row.split(",")[1] not in ("403", "0403")]
    rays.write_text("\n".join(rows) + "\n")
    block = read(folder)
    (finding,) = of_kind(block.structure.findings, Kind.NOT_USED)
    assert finding.severity == Severity.FAILED
    assert finding.subjects[0].table == "control"
    assert cure in finding.cure
    with_datum = folder / "block.toml"
    with_datum.write_text(with_datum.read_text() + '[datum]\ntype = "minimal"\n')
    assert all(finding.severity > Severity.FAILED for finding in read(folder).structure.findings)
