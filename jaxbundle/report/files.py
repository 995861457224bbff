"""The results of an adjustment as a folder: report.txt, report.json and CSV tables.

The result is never half-written: see `folder`. Files that no adjustment wrote remain in the folder.
"""

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.io.tables import Columns, write_table
from jaxbundle.report.data import dict_of, json_text
from jaxbundle.report.figures import figures_of
from jaxbundle.report.group_tables import table_names
from jaxbundle.report.html.page import html_of
from jaxbundle.report.made import Made, made_now, made_section
from jaxbundle.report.result_folder import DATA, PAGE, TEXT, replaced, require_writable
from jaxbundle.report.section import Picked, ReportTable, Section
from jaxbundle.report.sections import sections_of
from jaxbundle.report.text import text_of
from jaxbundle.solve.adjustment import Adjustment

ARRAYS = "adjustment.npz"
# bytes of a row in a table and in report.json, rounded up from reports of 2700 images, 540 thousand points and
# # 6.3 million rays, with names of 6 letters; a number has up to 24 letters, on average 18
_ROW = {"image": 700, "point": 400, "ray": 220, "other": 300}
_TEXT = 50_000  # report.txt shows the first rows of each table only
_PAGE, _MAX_PAGE = 150_000, 3_000_000  # report.html: style and script, and its maximum
_PAGE_ROW = 120  # bytes per point, as long as the page shows all points


def write_report(
    adjustment: Adjustment,
    folder: str | Path,
    found: tuple[Finding, ...] | None = None,
    made: Made | None = None,
) -> Path:
    """Writes all results of a concrete adjustment into a folder and returns its path.

    `found`: the findings of `findings`; computed if None. `made`: program, date, command and inputs; the current
    ones if None.

    Raises: FileExistsError where the folder contains files with these names that no adjustment wrote; another OSError
    where it cannot be written; ValueError for sensors that are not photographs.

    Example:
        >>> folder = jb.write_report(result, "results")
        >>> sorted(path.name for path in folder.iterdir())[:4]
        ['cameras.csv', 'check_points.csv', 'control.csv', 'images.csv']
    """
    require_a(Adjustment, adjustment, "write_report")
    require_photographs(adjustment.block, "write_report")
    robust = adjustment.reweighting is not None
    target, names = Path(folder), result_files(adjustment.block, robust)
    require_place(target, adjustment.block, robust)
    with np.errstate(all="ignore"):  # overflows and unknown values are empty in the tables
        figures = figures_of(adjustment, found)
        sections = [*(section() for section in sections_of(figures)), made_section(figures, made or made_now())]
        with replaced(target, names) as place:
            for table in (table for section in sections for table in tables_of(section)):
                write_table(place / f"{table.name}.csv", columns_of(table))
            (place / DATA).write_text(json_text({**dict_of(figures, sections), "files": names}), encoding="utf-8")
            (place / TEXT).write_text(text_of(figures, sections), encoding="utf-8")
            (place / PAGE).write_text(html_of(figures, sections), encoding="utf-8")
    return target


def result_files(block: Block, robust: bool = False) -> list[str]:
    """Names of the files of a report of this block, report.txt last."""
    parameters = ["parameters.csv"] if block.structure.parameters else []
    check = ["check_points.csv"] if len(block.structure.check_point) else []
    groups = [f"{name}.csv" for name in table_names(block)]
    robust_files = ["down_weighted.csv"] if robust else []
    fiducials = ["inner_orientation.csv", "fiducials.csv"] if block.structure.inner_orientations else []
    always = "images.csv", "cameras.csv", "points.csv", "rays.csv"
    return [*always, *parameters, *groups, *check, *fiducials, *robust_files, DATA, PAGE, TEXT]


def require_place(folder: str | Path, block: Block, robust: bool = False) -> None:
    """Checks before the adjustment that a report can be written to a folder: writes a file, and checks the free space.

    Raises: OSError in one sentence with the path and the cure.
    """
    require_writable(Path(folder), result_files(block, robust), report_size(block))


def report_size(block: Block) -> int:
    """Approximate size in bytes of a report of this block."""
    structure = block.structure
    rows = {
        "image": len(structure.image_names) + len(structure.cameras),
        "point": len(structure.point_names),
        "ray": len(structure.ray_image),
        "other": len(structure.parameters) + sum(len(group.values) for group in block.groups),
    }
    page = min(_PAGE + _PAGE_ROW * (rows["point"] + 10 * rows["image"]), _MAX_PAGE)
    return page + _TEXT + sum(_ROW[kind] * number for kind, number in rows.items())


def rescue(adjustment: Adjustment, found: tuple[Finding, ...] | None = None) -> Path:
    """Saves as much of an adjustment as possible to a new temporary folder, and returns the path of this folder.

    This is the whole report; if it fails, all arrays in one file and the tables that can be made.

    Raises: OSError where no temporary folder can be written.
    """
    folder = Path(tempfile.mkdtemp(prefix="jaxbundle-results-"))
    try:
        return write_report(adjustment, folder, found)
    except Exception:  # any error is reported elsewhere; here the numbers are saved
        leaves = jax.tree_util.tree_flatten_with_path(adjustment)[0]
        arrays: dict[str, Any] = {jax.tree_util.keystr(path).lstrip("."): np.asarray(leaf) for path, leaf in leaves}
        with (folder / ARRAYS).open("wb") as file:
            np.savez(file, **arrays)
    _write_possible(adjustment, folder)
    return folder


def _write_possible(adjustment: Adjustment, folder: Path) -> None:
    """Writes the tables that can be made."""
    try:
        sections = sections_of(figures_of(adjustment, ()))
    except Exception:
        return
    for section in sections:
        with suppress(Exception):
            for table in tables_of(section()):
                try:
                    write_table(folder / f"{table.name}.csv", columns_of(table))
                except Exception:
                    (folder / f"{table.name}.csv").unlink(missing_ok=True)


def tables_of(section: Section) -> list[ReportTable]:
    """The tables of a section that have a file."""
    return [part for part in section.parts if isinstance(part, ReportTable) and part.in_file]


def columns_of(table: ReportTable) -> Columns:
    """The columns of a table's file."""
    columns = {column.name: column.values for column in table.columns if column.in_file}
    return {
        name: pl.Series(values.names, dtype=pl.String)[values.index] if isinstance(values, Picked) else values
        for name, values in columns.items()
    }
