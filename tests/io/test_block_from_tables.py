"""A block from tables in memory is that of the same tables in a folder, with the same checks."""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import polars as pl
import pytest

import jaxbundle as jb


class Written(NamedTuple):
    """A folder, its tables as frames, and the other arguments."""

    folder: Path
    tables: dict[str, pl.DataFrame]
    options: dict[str, Any]


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Written:
    folder = tmp_path_factory.mktemp("tables") / "block"
    jb.write_block_folder(jb.simulate(1, 4, seed=1).block, folder)
    toml = tomllib.loads((folder / "block.toml").read_text())
    tables = {kind: pl.read_csv(folder / file) for kind, file in toml["tables"].items()}
    options = {
        "cameras": toml["cameras"],
        "sigma": toml["sigma"]["image"],
        "rotation": toml["rotation"]["system"],
        "name": toml["name"],
    }
    return Written(folder, tables, options)


def same(one: jb.Block, other: jb.Block) -> bool:
    pairs = zip(jax.tree_util.tree_leaves(one), jax.tree_util.tree_leaves(other), strict=True)
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@pytest.mark.parametrize("form", ["frames", "arrays", "lists", "paths"])
def test_tables_in_any_form_are_the_block_of_the_folder(written, form):
    make = {
        "frames": lambda kind: written.tables[kind],
        "arrays": lambda kind: {name: column.to_numpy() for name, column in written.tables[kind].to_dict().items()},
        "lists": lambda kind: written.tables[kind].to_dict(as_series=False),
        "paths": lambda kind: written.folder / f"{kind}.csv",
    }[form]
    block = jb.Block.from_tables(**{kind: make(kind) for kind in written.tables}, **written.options)
    folder = jb.read(written.folder)
    assert same(block, folder)
    assert block.structure.point_names == folder.structure.point_names


def test_problems_name_table_and_row_and_all_at_once(written):
    rays = written.tables["rays"].with_columns(pl.col("image").cast(pl.String))
    rays[3, "image"] = "nope"
    with pytest.raises(jb.BlockError) as error:
        jb.Block.from_tables(**{**written.tables, "rays": rays}, **written.options, angle_unit="grad")
    assert error.value.lines == (
        "rays:4: point 6 on image nope: image nope is not in images; add it there, correct the name or drop the row",
        "[units] angle is \"grad\"; give 'deg', 'gon' or 'rad'",
    )


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"image": ["1"], "point": ["1"], "x": [1.0]}, "column 'y' is missing"),
        ({"image": ["1"], "point": ["1"], "x": [1.0], "y": [1.0, 2.0]}, "the columns have 1 to 2 rows"),
        ({"image": [], "point": [], "x": [], "y": []}, "the table has no rows"),
    ],
)
def test_tables_of_a_wrong_form(written, table, words):
    with pytest.raises(jb.BlockError, match=words):
        jb.Block.from_tables(**{**written.tables, "rays": table}, **written.options)


def test_a_table_that_no_folder_has(written):
    with pytest.raises(jb.BlockError, match="distance is unknown"):
        jb.Block.from_tables(**written.tables, **written.options, distance={"from": ["1"]})
