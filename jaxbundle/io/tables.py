"""CSV tables: UTF-8, comma-separated, one header line, decimal point; an empty field is not given.

All fields are text until they are asked for as names or as numbers; what is wrong with them is noted in the user's
words, with file and line.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float, Int

from jaxbundle.io.findings import Findings

Columns = dict[str, list[str] | Float[np.ndarray, " row"]]

LISTED = 10  # names in one sentence


@dataclass(frozen=True)
class Table:
    """A table as text, blanks stripped, "" where nothing is given; `lines` are the lines of its rows in the file.

    `subject` says what a row is about, with the names of columns in braces: "point {point} on image {image}".
    """

    file: str
    subject: str
    text: pl.DataFrame
    lines: Int[np.ndarray, " row"]
    findings: Findings

    def note(self, row: int, what: str, cure: str) -> None:
        """Notes what is wrong with a row."""
        fields = self.text.row(row, named=True)
        names = [fields[column] for column in fields if f"{{{column}}}" in self.subject]
        self.findings.add(self.file, int(self.lines[row]), f"{self.subject.format(**fields)}: {what}", cure, names)

    def column(self, column: str) -> pl.Series:
        """A column as text; blank where the table does not have it."""
        return self.text[column] if column in self.text.columns else pl.Series([""] * len(self.lines))

    def names(self, column: str) -> pl.Series:
        """A column of names; none may be blank."""
        names = self.text[column]
        for row in _rows(names == ""):
            self.note(row, f"the {column} has no name", "name it or drop the row")
        return names

    def positions(self, column: str, names: Sequence[str], file: str) -> Int[np.ndarray, " row"]:
        """Positions of a column's names among those that another file defines; -1 and a note where one is not there."""
        wanted = self.names(column)
        positions = positions_of(wanted, names)
        for row in _rows(pl.Series(positions < 0) & (wanted != "")):
            self.note(row, f"{column} {wanted[row]} is not in {file}", "add it there, correct the name or drop the row")
        return positions

    def unique(self, *columns: str) -> None:
        """Notes every row that names the same as an earlier one."""
        if self.text.select(columns).is_unique().all():
            return
        first: dict[tuple, int] = {}
        for row, (line, key) in enumerate(zip(self.lines, self.text.select(columns).rows(), strict=True)):
            if first.setdefault(key, int(line)) != line and "" not in key:
                self.note(row, f"is already in line {first[key]}", "drop one of the two")

    def numbers(self, *columns: str, needed: bool = False) -> Float[np.ndarray, "row column"]:
        """Columns of numbers; NaN where a field is empty, which is noted where it is needed."""
        values = np.empty((len(self.lines), len(columns)))
        for k, column in enumerate(columns):
            text = self.column(column)
            given = text != ""
            values[:, k] = text.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
            for row in _rows(given & ~pl.Series(np.isfinite(values[:, k]))):
                values[row, k] = np.nan
                self.note(row, f"{column} is '{text[row]}', no finite number", "give a number with a decimal point")
            for row in _rows(~given) if needed else ():
                self.note(row, f"{column} is not given", "give a number or drop the row")
        return values

    def sigmas(self, *columns: str, zero: str = "", needed: bool = False) -> Float[np.ndarray, "row column"]:
        """Columns of standard deviations; `zero` tells the cure of a sigma that is 0, "" allows it."""
        values = self.numbers(*columns, needed=needed)
        for row, k in np.argwhere(values < 0).tolist():
            self.note(row, f"the standard deviation {columns[k]} is negative", "give a positive one")
        for row, k in np.argwhere(values == 0).tolist() if zero else ():
            self.note(row, f"the standard deviation {columns[k]} is 0", zero)
        return values


def _rows(mask: pl.Series) -> list[int]:
    return mask.arg_true().to_list()


def positions_of(wanted: pl.Series, names: Sequence[str]) -> Int[np.ndarray, " row"]:
    """Position of each wanted name among the names, of its first one if there are several; -1 where it is not there."""
    distinct = pl.Series("name", names, pl.String).to_frame().with_row_index("position").unique("name", keep="first")
    found = pl.Series("name", wanted).to_frame().with_row_index("row").join(distinct, on="name", how="left").sort("row")
    return found["position"].cast(pl.Int64).fill_null(-1).to_numpy()


def listed(names: Sequence[str]) -> str:
    """Names in one sentence, the first few of them if they are many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def read_text(path: Path, findings: Findings) -> str | None:
    """The text of a file; None and a note where there is none."""
    findings.files.append(path.name)
    if not path.is_file():
        findings.add(
            path.name, 0, "the file is missing", "add it to the folder, or drop what refers to it in block.toml"
        )
        return None
    data = path.read_bytes()
    try:
        return data.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        findings.add(path.name, line, f"byte 0x{data[error.start]:02x} is not UTF-8", "save the file in UTF-8")
        return None


def read_table(
    path: Path, subject: str, needed: Sequence[str], optional: Sequence[str], findings: Findings
) -> Table | None:
    """A table with these columns, in any order; None and notes where it cannot be read as one.

    Rows with a wrong number of fields are noted and left out; empty lines are passed over.
    """
    text = read_text(path, findings)
    if text is None:
        return None
    name = path.name
    header = [field.strip() for field in next(csv.reader(text.split("\n", 1)[:1]), [])]
    known = (*needed, *optional)
    missing = [column for column in needed if column not in header]
    unknown = [column for column in header if column not in known]
    twice = sorted({column for column in header if header.count(column) > 1})
    for columns, what, cure in (
        (missing, "missing", "add it"),
        (unknown, "unknown", f"rename it or drop it; known: {', '.join(known)}"),
        (twice, "given twice", "drop one of the two"),
    ):
        for column in columns:
            findings.add(name, 1, f"column '{column}' is {what}", cure)
    if missing or unknown or twice:
        return None
    frame, lines = (_quoted if '"' in text else _plain)(name, text, header, findings)
    if not len(lines):
        findings.add(name, 0, "the table has no rows", "fill it, or drop it and its entry in [tables]")
        return None
    return Table(name, subject, frame.select(pl.all().fill_null("").str.strip_chars()), lines, findings)


def _wrong_fields(file: str, line: int, fields: list[str], expected: int, findings: Findings) -> None:
    what = f"the row '{','.join(fields).strip()}' has {len(fields)} fields, the header {expected}"
    findings.add(file, line, what, "complete the row or drop it", [field.strip() for field in fields])


def _plain(file: str, text: str, header: list[str], findings: Findings) -> tuple[pl.DataFrame, Int[np.ndarray, " row"]]:
    """Rows of a table without quotes: lines with the right number of commas."""
    data = text.rstrip().encode()
    raw = np.frombuffer(data, np.uint8)
    ends = np.append(np.flatnonzero(raw == ord("\n")), len(raw))
    starts = np.append(0, ends[:-1] + 1)
    commas = np.diff(np.searchsorted(np.flatnonzero(raw == ord(",")), ends), prepend=0)
    right = commas == len(header) - 1
    for line in np.flatnonzero(~right):
        row = data[starts[line] : ends[line]].decode()
        if row.strip():
            _wrong_fields(file, int(line) + 1, row.split(","), len(header), findings)
    right[0] = False  # the header
    lines = np.flatnonzero(right)
    if not len(lines):
        return pl.DataFrame(schema=header), lines
    body = data[starts[1] :] if right[1:].all() else b"\n".join(data[starts[k] : ends[k]] for k in lines)
    frame = pl.read_csv(io.BytesIO(body), has_header=False, new_columns=header, infer_schema=False, quote_char=None)
    return frame, lines + 1


def _quoted(
    file: str, text: str, header: list[str], findings: Findings
) -> tuple[pl.DataFrame, Int[np.ndarray, " row"]]:
    """Rows of a table in which fields are quoted."""
    reader = csv.reader(io.StringIO(text), strict=True, skipinitialspace=True)
    rows, lines, line = [], [], 1
    try:
        for row in reader:
            if line > 1 and len(row) == len(header):
                rows.append(row)
                lines.append(line)
            elif line > 1 and "".join(row).strip():
                _wrong_fields(file, line, row, len(header), findings)
            line = reader.line_num + 1
    except csv.Error as error:
        findings.add(file, line, f"the row cannot be read: {error}", "close its quotes")
    schema = dict.fromkeys(header, pl.String)
    return pl.DataFrame(rows, schema=schema, orient="row"), np.array(lines, int)


def write_table(path: Path, columns: Columns) -> None:
    """Writes a table; numbers in the shortest form that reads back the same, NaN and "" as an empty field."""
    frame = pl.DataFrame(columns).with_columns(
        pl.selectors.float().fill_nan(None), pl.selectors.string().replace("", None)
    )
    frame.write_csv(path)
