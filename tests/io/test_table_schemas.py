"""The tables of the block folder are described once: the description holds, and a further kind is one entry of it."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from cases.same_block import assert_same, group_of
from cases.small_folder import append, change, make_small_folder, write

from jaxbundle.block.geodetic import position
from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.block.problems import BlockError
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS, Scalar
from jaxbundle.io import block_tables, read_block_folder, write_block_folder
from jaxbundle.io.block_tables import TABLES, format_columns, format_tables, table_of_kind
from jaxbundle.io.schema import Column, Holds, OwnerSchema, TableSchema, Unit

PAGE = Path(__file__).parents[2] / "jaxbundle" / "docs" / "block-folder.md"


def test_the_page_describes_the_tables() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert format_tables() in text and format_columns() in text


def test_every_column_is_described() -> None:
    text = format_columns()
    assert text.count("\n### ") == len(TABLES) - 1 and text.startswith("### images.csv\n\nApproximate values; an ")
    assert "| sX | standard deviation | object unit | empty, 0 |" in text
    assert "| cXY | further number | object unit squared | absent, empty |" in text


@pytest.mark.parametrize("system", ROTATION_SYSTEMS.values(), ids=lambda system: system.name)
def test_columns_of_a_rotation_system(system) -> None:
    for schema in TABLES.values():
        names = schema.in_system(system).names
        assert len(set(names)) == len(names)
    assert TABLES["attitudes"].in_system(system).of(Holds.VALUE) == system.angles


def test_angles_are_those_of_the_kinds() -> None:
    for kind, schema in table_of_kind().items():
        assert kind.name == schema.name and kind.angles == (schema.unit is Unit.ANGLE)


# A further kind: its entry and its residual


def _gradient(start: tuple, end: tuple, observed: tuple) -> tuple:
    a, b = position(start), position(end)
    return ((b[2] - a[2]) / jnp.hypot(b[0] - a[0], b[1] - a[1]) - observed[0],)


def _tilt(image: tuple, point: tuple, zero: Scalar, observed: tuple) -> tuple:
    up = jnp.arctan2(point[2] - image[0][2], point[0] - image[0][0])
    return up - zero - observed[0], up + zero - observed[1]


GRADIENTS = TableSchema(
    "gradients",
    "gradient {from} - {to}",
    (
        Column("from", Holds.END),
        Column("to", Holds.END),
        Column("gradient", empty="add the camera"),
        Column("sigma", Holds.SIGMA, zero="give a positive number"),
    ),
    "Z over distance",
    lambda start, end: ObservationKind("gradients", ("gradient",), (start, end), _gradient),
    plain=True,
)
TILTS = TableSchema(
    "tilts",
    "tilt of {point} from {image}",
    (
        Column("level", Holds.OWNER),
        Column("image", Holds.IMAGE),
        Column("point", Holds.POINT),
        *(Column(f"t{k}", unit=Unit.ANGLE) for k in "12"),
        *(Column(f"s{k}", Holds.SIGMA, Unit.ANGLE) for k in "12"),
    ),
    "in both faces",
    lambda *_: ObservationKind("tilts", ("t1", "t2"), ("image", "point", "parameter"), _tilt, angles=True),
    plain=True,
    owner=OwnerSchema((("index error", Unit.ANGLE),), table="levels"),
)
LEVELS = TableSchema(
    "levels",
    "level {level}",
    (
        Column("level", Holds.TEXT),
        Column("index", unit=Unit.OBJECT, empty="add the camera"),
        Column("sigma", Holds.SIGMA, Unit.OBJECT),
    ),
    "index errors",
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for schema in (GRADIENTS, TILTS, LEVELS):
        monkeypatch.setitem(block_tables.TABLES, schema.name, schema)
    folder = make_small_folder(tmp_path / "small")
    append(folder, "block.toml", 'gradients = "gradients.csv"\ntilts = "tilts.csv"\nlevels = "levels.csv"')
    write(folder, "gradients.csv", "from,to,gradient,sigma", ["101,102,0.1,0.01", "image:011,103,-5,0.02"])
    write(folder, "tilts.csv", "level,image,point,t1,t2,s1,s2", ["A,011,101,-90,-91,0.1,0.2"])
    write(folder, "levels.csv", "level,index,sigma", ["A,0.5,0.1"])
    return folder


def test_a_further_kind_is_read_and_written(folder: Path, tmp_path: Path) -> None:
    block = read_block_folder(folder, check_start=False)
    gradients = [group for group in block.groups if group.structure.kind.name == "gradients"]
    assert [group.structure.kind.touches for group in gradients] == [("point", "point"), ("image", "point")]
    assert [float(group.values[0, 0]) for group in gradients] == [0.1, -5.0]
    assert TILTS.kind is not None
    tilts = group_of(block, TILTS.kind())
    np.testing.assert_allclose(tilts.values, np.radians([[-90, -91]]), rtol=1e-15)
    np.testing.assert_allclose(tilts.sigmas, np.radians([[0.1, 0.2]]), rtol=1e-15)
    (parameter,) = block.structure.parameters
    assert parameter.name == "index error of level A" and float(block.parameters[0]) == 0.5
    write_block_folder(block, tmp_path / "again")
    assert_same(block, read_block_folder(tmp_path / "again", check_start=False))


def test_messages_about_a_further_kind(folder: Path) -> None:
    change(folder, "gradients.csv", 2, "101,102,0.1,0.01", "101,10Z,x,0")
    change(folder, "tilts.csv", 1, "level,image", "level,photo")
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert list(caught.value.lines) == [
        "gradients.csv:2: gradient 101 - 10Z: to 10Z is on no image and has no coordinates; measure it on an image, "
        "give it X, Y and Z in points.csv or control.csv, correct the name or drop the row",
        "gradients.csv:2: gradient 101 - 10Z: gradient is 'x', not a finite number; give a number with a decimal point",
        "gradients.csv:2: gradient 101 - 10Z: the standard deviation sigma is 0; give a positive number",
        "tilts.csv:1: column 'image' is missing and column 'photo' is unknown; "
        "rename 'photo' to 'image'; known: level, image, point, t1, t2, s1, s2",
    ]


def test_tables_that_are_not_known(tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    append(folder, "block.toml", 'gradients = "gradients.csv"')
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    (line,) = caught.value.lines
    assert line == f"block.toml:30: [tables] gradients is unknown; known tables: {', '.join(TABLES)}"
