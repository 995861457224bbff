"""The header line of a table: its separator and columns, and what is wrong with them."""

import csv
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from jaxbundle.block.problems import shown
from jaxbundle.io.block_tables import OTHER_NAMES
from jaxbundle.io.noted import Noted, listed
from jaxbundle.io.schema import TableSchema

SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab"}
OTHERS = {"|": "'|'", " ": "blanks", ":": "':'"}  # reported, not read
MANY = 100  # columns: several times the number of any table


class Header(NamedTuple):
    """The columns in their order, their separator, and the number of the header line, counted from 1."""

    columns: list[str]
    separator: str
    line: int


def read_header(file: str, text: str, schema: TableSchema, noted: Noted) -> Header | None:
    """Finds the header of a table; None and one note where the columns do not fit the table.

    The header is the first line that is neither empty nor a comment; a comment begins with #.
    """
    line, number = _first_line(text)
    found = {separator: _fields(line, separator) for separator in (*SEPARATORS, *OTHERS)}
    score = {separator: len(set(schema.names).intersection(fields)) for separator, fields in found.items()}
    best = max(score, key=lambda separator: score[separator])
    if not score[best]:  # not one column is known
        best = max(SEPARATORS, key=lambda separator: len(found[separator]))
    if best in OTHERS and score[best] > 1:
        noted.add(file, number, f"the fields are separated by {OTHERS[best]}", "separate them by commas")
        return None
    best = best if best in SEPARATORS else ","
    problem = problem_of_columns(found[best], schema, line)
    if problem:
        noted.add(file, number, *problem)
        return None
    return Header(found[best], best, number)


def _first_line(text: str) -> tuple[str, int]:
    """The first line of a text that is neither empty nor a comment, and its number."""
    start = number = 0
    while start < len(text):
        number += 1
        end = text.find("\n", start)
        line = text[start : end if end >= 0 else len(text)]
        if line.strip() and not line.lstrip().startswith("#"):
            return line, number
        start += len(line) + 1
    return "", 1


def _fields(line: str, separator: str) -> list[str]:
    if separator == " " or '"' not in line:
        fields = line.split(None if separator == " " else separator)
    else:
        try:
            fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:  # a field that is longer than the csv module accepts
            fields = line.split(separator)
    return [field.strip() for field in fields]


def problem_of_columns(columns: list[str], schema: TableSchema, line: str) -> tuple[str, str] | None:
    """The problem of the columns of a header, and its cure."""
    needed, known = schema.needed, schema.names
    if not line.strip():
        return "the table has no header", f"begin the table with its header: {','.join(needed)}"
    if len(columns) > MANY:
        what = f"the header '{shown(line)}' has {len(columns)} columns"
        return what, f"begin the table with its header, {','.join(needed)}, and end each row with a line end"
    missing = [column for column in needed if column not in columns]
    unknown = list(dict.fromkeys(column for column in columns if column not in known))
    twice = sorted(column for column, count in Counter(columns).items() if count > 1)
    if "" in unknown and not missing and unknown == [""]:
        return "the header has a column without name", "drop the separator at the end of the lines, or name the column"
    if all(map(_is_number, columns)):
        return f"the first line '{shown(line)}' is not a header", f"begin the table with its header: {','.join(needed)}"
    if not (missing or unknown):
        return (f"{_columns(twice)} given twice", "drop one of the two") if twice else None
    said = [f"{_columns(names)} {what}" for names, what in ((missing, "missing"), (unknown, "unknown")) if names]
    meant = _meant(unknown, missing or [column for column in known if column not in columns])
    if meant:
        renamed = ", ".join(f"'{shown(theirs)}' to '{ours}'" for theirs, ours in meant.items())
        left = [column for column in missing if column not in meant.values()]
        more = f" and add {listed(left)}" if left else ""
        cure = f"rename {renamed}{more}; known: {', '.join(known)}"
    elif unknown:
        rename = "rename it or drop it" if len(unknown) == 1 else "rename or drop them"
        cure = f"{rename}; known: {', '.join(known)}"
    else:
        plain = "add it" if len(missing) == 1 else "add them"
        cure = next((cure for column in missing if (cure := schema.column(column).missing)), plain)
    return " and ".join(said), cure


def _columns(names: Sequence[str]) -> str:
    quoted = ", ".join(f"'{shown(name)}'" for name in names[:MANY])
    return f"column {quoted} is" if len(names) == 1 else f"columns {quoted} are"


def _meant(unknown: Sequence[str], missing: Sequence[str]) -> dict[str, str]:
    """Unknown columns, each with the missing column that it probably is."""
    meant: dict[str, str] = {}
    for theirs in unknown:
        key = "".join(c for c in theirs.casefold() if c.isalnum())
        alike = [ours for ours in missing if key in (ours.casefold(), *OTHER_NAMES.get(ours, "").split())]
        free = [ours for ours in alike if ours not in meant.values()]
        if free and key:
            meant[theirs] = free[0]
    return meant


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True
