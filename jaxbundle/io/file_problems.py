"""Problems of a block that was read from a folder, with file and line: causes first, one line for each problem."""

import re

import numpy as np

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import Problem
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.folder_tables import FolderTables
from jaxbundle.io.noted import Noted, listed

NUMBER = re.compile(r"\d+")


def told_of(problems: list[Problem], block: Block, toml: BlockToml, tables: FolderTables, noted: Noted) -> None:
    """Notes problems of the block, similar ones together; unused observations, which may be the cause, come first.

    Problems that follow from wrong rows are left out.
    """
    structure = block.structure
    if not (problems or noted):
        return
    wrong = {placed.file for placed in noted.found}
    for finding in structure.findings:
        file, line = _place_of(finding, tables)
        unused = finding.kind in (Kind.NOT_USED, Kind.UNUSED) and finding.severity < Severity.NOTE
        if unused and file not in wrong:  # else it may follow from those problems
            noted.add_cause(file, line, finding.what, finding.cure)
    alike: dict[tuple[str, str, str], list[tuple[Problem, str]]] = {}
    for problem in problems:
        name = _name(structure, problem)
        if name in noted.touched or (noted.lost_images and problem.table == "images"):
            continue
        words = NUMBER.sub("#", problem.what.replace(f" {name} ", " # ", 1) if name else problem.what)
        alike.setdefault((problem.table, words, problem.cure), []).append((problem, name))
    for members in alike.values():
        first, name = members[0]
        others = [other for _, other in members[1:]]
        also = listed(others) if name else f"{len(others)} more rows"
        what = f"{first.what}; likewise {also}" if others else first.what
        noted.add_problem(
            *_place(first, block, toml, tables), Problem(what, first.cure, first.table, count=len(members))
        )


def _place_of(finding: Finding, tables: FolderTables) -> tuple[str, int]:
    """File and line of the first subject of a finding."""
    subject = finding.subjects[0] if finding.subjects else None
    rows = tables.known.get(subject.table) if subject else None
    if rows is None or not subject or not subject.names or subject.names[0] not in rows.names:
        return FILE, 0
    return rows.table.file, int(rows.table.lines[rows.names.index(subject.names[0])])


def _name(structure: Structure, problem: Problem) -> str:
    """Name of the image or the point that a problem of a row is about; "" for any other."""
    if problem.row is None or problem.table not in ("rays", "images", "points"):
        return ""
    if problem.table == "rays":
        return structure.point_names[structure.ray_point[problem.row]]
    return (structure.image_names if problem.table == "images" else structure.point_names)[problem.row]


def _place(problem: Problem, block: Block, toml: BlockToml, tables: FolderTables) -> tuple[str, int]:
    """File and line of a problem of the block."""
    row, kind = problem.row, problem.table
    if kind == "cameras" and row is not None:
        return FILE, toml.line("cameras", block.structure.cameras[row].name)
    if kind == "datum":
        return FILE, toml.line("datum", "elements")
    if kind == "points" and row is not None:
        return _place_of_point(row, block.structure, tables)
    table = tables.table(kind)
    if table is None:
        return "", 0
    if row is not None and kind in tables.known:
        row = tables.known[kind].members[row]
    return table.file, 0 if row is None else int(table.lines[row])


def _place_of_point(point: int, structure: Structure, tables: FolderTables) -> tuple[str, int]:
    """File and line of the first ray of a point; for a point on no image, of its coordinates."""
    rays = np.flatnonzero(structure.ray_point == point)
    if len(rays):
        return tables.rays.table.file, int(tables.rays.table.lines[rays[0]])
    for rows in (tables.known[kind] for kind in ("points", "control") if kind in tables.known):
        if point in rows.position:
            return rows.table.file, int(rows.table.lines[np.argmax(rows.position == point)])
    return "", 0
