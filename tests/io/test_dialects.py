"""Forms in which spreadsheets and editors write tables: the same block, or one line with the cause."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cases.same_block import assert_same
from cases.small_folder import append, change, make_small_folder, write

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError
from jaxbundle.io import read_block_folder

TABLES = ("images.csv", "rays.csv", "points.csv", "control.csv")
Form = Callable[[str], bytes]


def semicolons(text: str) -> str:
    return text.replace(",", ";")


def decimal_commas(text: str) -> str:
    """Decimal commas in every field that is a number."""
    return "\n".join(";".join(field.replace(".", ",") for field in line.split(",")) for line in text.split("\n"))


def quoted(text: str, separator: str) -> str:
    """Every field in quotes."""
    return "\n".join(separator.join(f'"{field}"' for field in line.split(",")) for line in text.strip().split("\n"))


SAME: dict[str, Form] = {
    "semicolons": lambda text: semicolons(text).encode(),
    "semicolons and decimal commas": lambda text: decimal_commas(text).encode(),
    "tabs": lambda text: text.replace(",", "\t").encode(),
    "tabs and decimal commas": lambda text: decimal_commas(text).replace(";", "\t").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "CR LF and byte order mark": lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16, big end first": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "UTF-32": lambda text: text.encode("utf-32"),
    "empty rows of a spreadsheet": lambda text: (text + 3 * ("," * text.partition("\n")[0].count(",") + "\n")).encode(),
    "comments before the header": lambda text: ("# made by hand, 2\n\n # more\n" + text).encode(),
    "comments and quotes": lambda text: ("# a\n\n" + quoted(text, ",")).encode(),
    "quotes": lambda text: quoted(text, ",").encode(),
    "quotes and semicolons": lambda text: quoted(text, ";").encode(),
}  # fmt: skip


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Block:
    return read_block_folder(make_small_folder(tmp_path_factory.mktemp("plain") / "small"))


@pytest.mark.parametrize("form", SAME)
def test_the_same_block(plain: Block, tmp_path: Path, form: str) -> None:
    folder = make_small_folder(tmp_path / "small")
    for file in TABLES:
        (folder / file).write_bytes(SAME[form]((folder / file).read_text()))
    block = read_block_folder(folder)
    assert block.structure.findings == ()
    assert_same(block, plain)


REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "blanks": (
        lambda folder: write(folder, "points.csv", "point X Y Z", ["101 1 2 3"]),
        "points.csv:1: the fields are separated by blanks; separate them by commas",
    ),
    "UTF-16 without mark": (
        lambda folder: (folder / "points.csv").write_bytes("point,X,Y,Z\n101,1,2,3\n".encode("utf-16-le")),
        "points.csv: the file looks like UTF-16 without a byte order mark; save the file in UTF-8",
    ),
    "compressed": (
        lambda folder: (folder / "points.csv").write_bytes(b"\x1f\x8b\x08" + b"x" * 50),
        "points.csv: the file is compressed (gzip); give it as plain text in UTF-8",
    ),
    "spreadsheet": (
        lambda folder: (folder / "points.csv").write_bytes(b"PK\x03\x04" + b"x" * 50),
        "points.csv: the file is a zip archive, or a table of a spreadsheet program; give it as plain text in UTF-8",
    ),
    "no header": (
        lambda folder: write(folder, "points.csv", "101,1,2,3", ["102,1,2,3"]),
        "points.csv:1: the first line '101,1,2,3' is not a header; begin the table with its header: point,X,Y,Z",
    ),
    "only comments": (
        lambda folder: write(folder, "points.csv", "# one", ["", "# two"]),
        "points.csv:1: the table has no header; begin the table with its header: point,X,Y,Z",
    ),
    "decimal commas among commas": (
        lambda folder: write(folder, "points.csv", "point,X,Y,Z", ["101,1,5,2,5,3,5", "102,1,5,2,5,3,5"]),
        "points.csv:2: 2 rows (lines 2, 3), such as the row '101,1,5,2,5,3,5' has 7 fields, the header 4; "
        "if the numbers have decimal commas, use points, or separate the fields by semicolons",
    ),
    "empty file": (
        lambda folder: (folder / "points.csv").write_text(""),
        "points.csv: the file is empty; add rows, or drop it and its entry in [tables]",
    ),
    "separator at the end": (
        lambda folder: write(folder, "points.csv", "point,X,Y,Z,", ["101,1,2,3,"]),
        "points.csv:1: the header has a column without name; drop the separator at the end of the lines",
    ),
    "both decimal signs": (
        lambda folder: write(folder, "points.csv", "point;X;Y;Z", ["101;1.5;2;3", "102;1,5;2;3", "103;1,5;2;3"]),
        "points.csv:3: 2 rows (lines 3, 4), such as point 102: X is '1,5', not a finite number; a comma is read as",
    ),
    "thousands": (
        lambda folder: write(folder, "points.csv", "point;X;Y;Z", ["101;1.234,5;2;3"]),
        "points.csv:2: point 101: X is '1.234,5', not a finite number; remove the separators of thousands",
    ),
    "too small": (
        lambda folder: change(folder, "control.csv", 3, "0.04", "1e-400"),
        "control.csv:3: point 102: sZ is '1e-400', too small to be plausible; give 0, or correct it",
    ),
    "minus nothing": (
        lambda folder: change(folder, "control.csv", 3, "0.04", "-0"),
        "control.csv:3: point 102: the standard deviation sZ is negative; give a positive number",
    ),
    "small sigma": (
        lambda folder: change(folder, "control.csv", 3, "0.04", "1e-99"),
        "control.csv:3: point 102: the standard deviation sZ is smaller than 1e-15; correct it, or its unit",
    ),
    "two roles": (
        lambda folder: append(folder, "control.csv", "103,1,2,3,,,,check"),
        "control.csv:7: point 103: is check here and control in line 4; drop one of the two",
    ),
    "no role": (
        lambda folder: change(folder, "control.csv", 3, "control", ""),
        "control.csv:3: point 102: role is not given; give one of control, check",
    ),
    "a row that cannot be read, and what names it": (
        lambda folder: change(folder, "images.csv", 3, ",wide", ""),
        "images.csv:3: the row '012,20.0,-14.0,102.0,-1.0,4.0,-5.0' has 7 fields, the header 8; complete the row",
    ),
    "absolute path": (
        lambda folder: change(folder, "block.toml", 28, "points.csv", "/etc/passwd"),
        "block.toml:28: [tables] points = '/etc/passwd' is outside the folder; copy or link the table",
    ),
    "path upwards": (
        lambda folder: change(folder, "block.toml", 28, "points.csv", "../points.csv"),
        "block.toml:28: [tables] points = '../points.csv' is outside the folder",
    ),
    "true as format": (
        lambda folder: change(folder, "block.toml", 1, "1", "true"),
        "block.toml:1: format is true; give 1",
    ),
    "points of a free network as text": (
        lambda folder: append(folder, "block.toml", '[datum]\ntype = "inner"\npoints = "all"'),
        "block.toml:32: [datum] points is 'all', not a list; name points in brackets",
    ),
    "text for a number": (
        lambda folder: change(folder, "block.toml", 17, "50.0", '"50.0"'),
        'block.toml:17: [cameras.wide] principal_distance is "50.0"; give a number, without quotes and without unit',
    ),
    "principal distance of nothing": (
        lambda folder: change(folder, "block.toml", 17, "50.0", "1e-320"),
        "block.toml:17: [cameras.wide] principal_distance is 1e-320, not from 1e-06 to 1e+09; correct it, or its unit",
    ),
    "escape in a camera's name": (
        lambda folder: append(folder, "block.toml", '[cameras."a\\u001b[31m"]\nimage_unit = "px"'),
        "block.toml",
    ),
    "escape in a name": (
        lambda folder: change(folder, "rays.csv", 2, "101", "1\x1b[31m01"),
        "rays.csv:2: point 1\\x1b[31m01 on image 011: the point has an invisible character; delete this character",
    ),
    "direction of writing in a name": (
        lambda folder: change(folder, "rays.csv", 2, "101", "1\u202e01"),
        "rays.csv:2: point 1\\u202e01 on image 011: the point has an invisible character",
    ),
}  # fmt: skip
SEVERAL = ("escape in a camera's name",)


@pytest.mark.parametrize("name", REFUSED)
def test_one_line_names_the_cause(tmp_path: Path, name: str) -> None:
    edit, expected = REFUSED[name]
    folder = make_small_folder(tmp_path / "small")
    edit(folder)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert caught.value.lines[0].startswith(expected), "\n".join(caught.value.lines)
    assert len(caught.value.lines) == 1 or name in SEVERAL, "\n".join(caught.value.lines)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    ("file", "line", "old", "new"),
    [
        ("control.csv", 3, "control", "CONTROL"),
        ("block.toml", 6, '"m"', '"M"'),
        ("block.toml", 7, '"deg"', '"Deg"'),
        ("block.toml", 10, "omega-phi-kappa", "Omega-Phi-Kappa"),
        ("block.toml", 13, '"px"', '"PX"'),
    ],
)
def test_case_does_not_matter(plain: Block, tmp_path: Path, file: str, line: int, old: str, new: str) -> None:
    folder = make_small_folder(tmp_path / "small")
    change(folder, file, line, old, new)
    assert_same(read_block_folder(folder), plain)


def test_many_rows_are_one_line(tmp_path: Path) -> None:
    """Of 50 000 rows with nine wrong fields each, quickly told."""
    folder = make_small_folder(tmp_path / "small")
    rows = 50_000
    with (folder / "images.csv").open("a") as file:
        file.write("-" + ",x" * 7 + "\n" + "-,,,,,,,\n" * (rows - 1))
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert len(caught.value.lines) <= 6
    assert max(problem.count for problem in caught.value.problems) >= rows - 1
    assert len(str(caught.value)) < 2000


def test_long_names_are_shortened(tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    change(folder, "rays.csv", 2, "011", "a" * 5000)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    (line,) = caught.value.lines
    assert len(line) < 500 and "(5000 characters)" in line


def test_points_measured_again_are_told_once(tmp_path: Path) -> None:
    """The finding of a point that an image measures twice counts them; both rays are used."""
    folder = make_small_folder(tmp_path / "small")
    append(folder, "rays.csv", "011,101,1613.5,1648.5,,\n011,102,1200,1600,,\n021,101,1,2,,")
    block = read_block_folder(folder)
    (finding,) = block.structure.findings
    assert len(block.structure.ray_point) == 51
    assert [subject.names for subject in finding.subjects] == [("011", "101"), ("011", "102"), ("021", "101")]
    assert finding.what.startswith("3 rays repeat a point")
    assert np.isfinite(np.asarray(block.object_points)).all()


@pytest.mark.parametrize(
    "ends",
    ["blank-lines", "blanks", "bom", "comment", "cr-only", "crlf", "no-final-newline"]
    + [
        "plus-exponent",
        "quoted",
        "reordered",
        "semicolon",
        "semicolon-decimal-comma",
        "tab",
        "trailing-spaces",
        "utf16",
    ],
)
def test_a_block_in_many_dialects(shared_data: Path, ends: str) -> None:
    folder = shared_data / "cases" / "18-file-dialects"
    assert_same(read_block_folder(folder / ends), read_block_folder(folder / "plain"))


@pytest.mark.parametrize(
    ("name", "words"), [("decimal-comma", "decimal commas"), ("latin1-name", "save the file in UTF-8")]
)
def test_what_is_no_dialect(shared_data: Path, name: str, words: str) -> None:
    """One line for each of the files."""
    with pytest.raises(BlockError) as caught:
        read_block_folder(shared_data / "cases" / "18-file-dialects" / name)
    assert all(words in line for line in caught.value.lines)
    assert len(caught.value.lines) == len({line.partition(":")[0] for line in caught.value.lines})
