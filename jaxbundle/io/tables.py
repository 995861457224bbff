"""CSV tables with one header line; an empty field means "not given".

Fields are separated by commas, semicolons or tabs. Numbers have a decimal point, or a decimal comma where the fields
are not separated by commas. All fields are text until they are read as names or as numbers. Problems are noted with
file and line, one note for all rows with the same cause.
"""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int

from jaxbundle.block.problems import is_hidden, shown
from jaxbundle.io.header import Header, read_header
from jaxbundle.io.near_names import Match, nearest
from jaxbundle.io.noted import Noted
from jaxbundle.io.ranges import NOTHING, SMALLEST_SIGMA
from jaxbundle.io.schema import Column, TableSchema
from jaxbundle.io.text_files import read_text

Columns = Mapping[str, Sequence[str] | pl.Series | Float[np.ndarray, " _row"]]
Rows = Sequence[int] | Int[np.ndarray, " noted"]
Words = str | Callable[[int], str]  # of a row, or a function of the row number

ROW = 120  # maximum number of characters of a row in a message
LISTED_UNKNOWN = 1000  # maximum number of unknown names that are compared with the known ones
DECIMAL_COMMA = r"^[+-]?\d*,\d+(?:[eE][+-]?\d+)?$"
THOUSANDS = (
    r"^[+-]?(?:\d+(?:['\u2019\u00a0\u202f _]\d+)+(?:[.,]\d*)?"
    r"|\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:[.,]\d{3}){2,}))$"
)
NOT_NOTHING = r"^[^eE]*[1-9]"  # a number with one of these digits is not 0
NOT_A_NUMBER = (  # forms of fields that are not numbers, with their cures
    (DECIMAL_COMMA, "a comma is read as decimal sign only where semicolons or tabs separate the fields; use a point"),
    (THOUSANDS, "remove the separators of thousands, and use a decimal point"),
    ("", "give a number with a decimal point"),
)


@dataclass(frozen=True)
class Table:
    """A table as text, blanks stripped, "" for empty fields; `lines` are the line numbers of its rows in the file.

    `half_turn` is half a turn in the angle unit.
    """

    file: str
    schema: TableSchema
    text: pl.DataFrame
    lines: Int[np.ndarray, " row"]
    noted: Noted
    separator: str
    half_turn: float

    def note(self, rows: int | Rows, what: Words, cure: str) -> None:
        """Notes a problem of one row, or of several rows with the same cause; no rows give no note."""
        numbers = np.atleast_1d(np.asarray(rows, int))
        if not len(numbers):
            return
        first = int(numbers[0])
        fields = {column: shown(text) for column, text in self.text.row(first, named=True).items()}
        subject = self.schema.subject
        named = [column for column in fields if f"{{{column}}}" in subject]
        for column in named:
            self.noted.touched.update(self.text[column].gather(numbers).unique())
        told = f"{subject.format(**fields)}: {what if isinstance(what, str) else what(first)}"
        self.noted.add_rows(self.file, self.lines[numbers].tolist(), told, cure)

    def column(self, column: str) -> pl.Series:
        """A column as text; blank where the table does not have this column."""
        return self.text[column] if column in self.text.columns else pl.Series([""] * len(self.lines))

    def names(self, column: str) -> pl.Series:
        """A column of names; blank names and names with an invisible character are noted."""
        names = self.text[column]
        self.note(where(names == ""), f"the {column} has no name", "add the name or drop the row")
        odd = [name for name in names.unique() if not name.isprintable() and any(map(is_hidden, name))]
        if odd:
            what = f"the {column} has an invisible character"
            self.note(where(names.is_in(odd)), what, "delete this character from the name")
        return names

    def positions(self, column: str, names: Sequence[str], file: str) -> Int[np.ndarray, " row"]:
        """Indices of a column's names among the names that another file defines; -1 and a note for a missing name."""
        wanted = self.names(column)
        positions = positions_of(wanted, names)
        missing = (wanted != "") & pl.Series(positions < 0)
        if missing.any() and self.noted.broken:
            missing &= ~wanted.is_in(list(self.noted.broken))
        rows = where(missing)
        if len(rows):
            match = nearest(wanted.gather(rows).unique(maintain_order=True).head(LISTED_UNKNOWN), names)
            if match:
                self.noted.touched.update(match.pairs.values())
            known = "" if len(names) > 3 or match else f"known: {', '.join(map(shown, names))}; "
            said = f"{match} " if match else known
            cure = f"{said}add it there, correct the name or drop the row"
            self.note(rows, lambda row: f"{column} {shown(wanted[row])} is not in {file}", cure)
        return positions

    def unique(self, *columns: str) -> None:
        """Notes rows with the same name as an earlier row."""
        rows, first = self.repeated(*columns)
        if len(rows):
            line = self.lines[first[0]]
            self.note(rows, f"is already in line {line}", "drop one of the two")

    def repeated(self, *columns: str) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " row"]]:
        """Rows that agree in these columns with an earlier row, and these earlier rows."""
        keys = self.text.select(columns).with_row_index("row")
        if keys.select(columns).is_unique().all():
            return np.zeros(0, int), np.zeros(0, int)
        given = keys.filter(pl.all_horizontal(pl.col(columns) != ""))
        first = given.with_columns(pl.col("row").first().over(columns).alias("first"))
        again = first.filter(pl.col("row") != pl.col("first"))
        return again["row"].to_numpy().astype(int), again["first"].to_numpy().astype(int)

    def numbers(self, *columns: str, spared: Rows = ()) -> Float[np.ndarray, "row column"]:
        """Columns of numbers; NaN where a field is empty, is not a number, or is out of range.

        Violations of the schema are noted, except empty fields of the rows in `spared`.
        """
        texts = [self._decimal_point(self.column(column), columns) for column in columns]
        values = np.stack([text.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy() for text in texts], 1)
        given = np.stack([(text != "").to_numpy() for text in texts], 1)
        self._note_unreadable(columns, given & ~np.isfinite(values))
        size = np.abs(values)
        nothing = size < NOTHING
        if nothing.any():
            nothing &= np.stack([text.str.contains(NOT_NOTHING).to_numpy() for text in texts], 1)
        described = [self.schema.column(column) for column in columns]
        finite, limits = np.isfinite(values), [column.maximum(self.half_turn) for column in described]
        large = finite & (size > np.array(limits))
        self._note_fields(columns, large, [f"larger than {limit:g}" for limit in limits], "correct it, or its unit")
        self._note_fields(columns, nothing, ["too small to be plausible"] * len(columns), "give 0, or correct it")
        finite &= ~large & ~nothing
        needed = described[0].empty
        rows = np.setdiff1d(np.flatnonzero(~given.all(1)), spared) if needed else ()
        self.note(rows, lambda row: _not_given(columns, ~given[row]), needed)
        values = np.where(finite, values, np.nan)
        for k, column in enumerate(described):
            self._note_range(column, values[:, k])
        return values

    def _note_range(self, column: Column, values: Float[np.ndarray, " row"]) -> None:
        """Notes numbers of one column that are not positive, or not zenith angles in the first face."""
        called = self.schema.row if self.schema.plain else column.name
        if column.positive:
            self.note(np.flatnonzero(values <= 0), f"the {called} is not positive", column.positive)
        if column.first_face:
            outside = np.flatnonzero((values <= 0) | (values >= self.half_turn))
            self.note(outside, f"the {called} is not between 0 and {self.half_turn:g}", column.first_face)

    def _decimal_point(self, text: pl.Series, columns: Sequence[str]) -> pl.Series:
        """The text of numbers with decimal points, where commas are certainly decimal ones."""
        if self.separator == "," or not text.str.contains(",", literal=True).any():
            return text
        if any(self.column(column).str.contains(".", literal=True).any() for column in columns):
            return text
        return text.str.replace(",", ".", literal=True)

    def _note_unreadable(self, columns: Sequence[str], wrong: Bool[np.ndarray, "row column"]) -> None:
        """Notes fields that are not numbers; fields of the same form are noted together."""
        left = wrong.copy()
        for form, cure in NOT_A_NUMBER if wrong.any() else ():
            alike = [self.column(column).str.contains(form).to_numpy() for column in columns]
            of_form = left & np.stack(alike, 1)
            self._note_fields(columns, of_form, ["not a finite number"] * len(columns), cure)
            left &= ~of_form

    def _note_fields(
        self, columns: Sequence[str], wrong: Bool[np.ndarray, "row column"], what: Sequence[str], cure: str
    ) -> None:
        """Notes problems of fields; `what`: the problem for each column."""

        def words(row: int) -> str:
            k = int(np.argmax(wrong[row]))
            return f"{columns[k]} is '{shown(self.text[columns[k]][row])}', {what[k]}"

        self.note(np.flatnonzero(wrong.any(1)), words, cure)

    def sigmas(self, *columns: str, spared: Rows = ()) -> Float[np.ndarray, "row column"]:
        """Columns of standard deviations; `spared` as for `numbers`."""
        values = self.numbers(*columns, spared=spared)
        small = (values > 0) & (values < SMALLEST_SIGMA)
        zero = self.schema.column(columns[0]).zero
        for wrong, what, cure in (
            (np.signbit(values) & ~np.isnan(values), "negative", "give a positive number"),
            (small, f"smaller than {SMALLEST_SIGMA:g}", "correct it, or its unit"),
            ((values == 0) & bool(zero), "0", zero),
        ):
            self.note(np.flatnonzero(wrong.any(1)), self._sigma_words(columns, wrong, what), cure)
        return np.where(small, np.nan, values)

    def _sigma_words(self, columns: Sequence[str], wrong: Bool[np.ndarray, "row column"], what: str) -> Words:
        return lambda row: f"the standard deviation {columns[int(np.argmax(wrong[row]))]} is {what}"


def _not_given(columns: Sequence[str], missing: Bool[np.ndarray, " column"]) -> str:
    names = [column for column, is_missing in zip(columns, missing, strict=True) if is_missing]
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} not given"


def where(mask: pl.Series) -> Int[np.ndarray, " row"]:
    """Rows in which a mask is true."""
    return mask.arg_true().to_numpy().astype(int)


def positions_of(wanted: pl.Series, names: Sequence[str]) -> Int[np.ndarray, " row"]:
    """Index of each wanted name among the names, of the first one if there are several; -1 where it is missing."""
    distinct = pl.Series("name", names, pl.String).to_frame().with_row_index("position").unique("name", keep="first")
    found = pl.Series("name", wanted).to_frame().with_row_index("row").join(distinct, on="name", how="left").sort("row")
    return found["position"].cast(pl.Int64).fill_null(-1).to_numpy()


def near(unknown: Sequence[str], known: Sequence[str]) -> Match | None:
    """The change that makes unknown names known, from the first of them."""
    return nearest(unknown[:LISTED_UNKNOWN], known)


def read_table(path: Path, schema: TableSchema, noted: Noted, half_turn: float = 180.0) -> Table | None:
    """Reads a table with the columns of a schema, in any order; None and notes where it cannot be read.

    Rows with a wrong number of fields are noted and left out; empty lines are skipped.
    """
    text = read_text(path, noted)
    if text is None:
        return None
    name = path.name
    if not text.strip():
        noted.add(name, 0, "the file is empty", "add rows, or drop it and its entry in [tables]")
        return None
    header = read_header(name, text, schema, noted)
    if header is None:
        return None
    wrong = len(noted.found)
    frame, lines = (_quoted if '"' in text else _plain)(name, text, header, noted)
    frame = frame.select(pl.all().fill_null("").str.strip_chars())
    blank = frame.select(pl.all_horizontal(pl.all() == "")).to_series()
    if blank.any():  # spreadsheets append such lines
        frame, lines = frame.filter(~blank), lines[~blank.to_numpy()]
    if not len(lines):
        if len(noted.found) == wrong:
            noted.add(name, 0, "the table has no rows", "add rows, or drop it and its entry in [tables]")
        return None
    return Table(name, schema, frame, lines, noted, header.separator, half_turn)


def _wrong_fields(file: str, rows: list[tuple[int, list[str]]], header: Header, noted: Noted) -> None:
    """Notes rows with a number of fields that differs from the header."""
    if rows:
        fields = rows[0][1]
        row = shown(header.separator.join(fields).strip(), ROW)
        what = f"the row '{row}' has {len(fields)} fields, the header {len(header.columns)}"
        cure = "complete the row or drop it"
        if header.separator == "," and len(fields) > len(header.columns) and len(rows) > 1:
            cure = "if the numbers have decimal commas, use points, or separate the fields by semicolons"
        noted.add_rows(file, [line for line, _ in rows], what, cure)
        noted.broken.update(field.strip() for _, fields in rows for field in fields)
        noted.touched.update(noted.broken)


def _plain(file: str, text: str, header: Header, noted: Noted) -> tuple[pl.DataFrame, Int[np.ndarray, " row"]]:
    """Rows of a table without quotes: lines with the right number of separators."""
    data = text.rstrip("\n ").encode()
    raw = np.frombuffer(data, np.uint8)
    ends = np.append(np.flatnonzero(raw == ord("\n")), len(raw))
    starts = np.append(0, ends[:-1] + 1)
    separators = np.diff(np.searchsorted(np.flatnonzero(raw == ord(header.separator)), ends), prepend=0)
    right = separators == len(header.columns) - 1
    wrong = []
    right[: header.line] = True  # the header and the lines before it
    for line in np.flatnonzero(~right).tolist():
        row = data[starts[line] : ends[line]].decode()
        if row.strip(f"{header.separator} \t"):
            wrong.append((line + 1, row.split(header.separator)))
    _wrong_fields(file, wrong, header, noted)
    right[: header.line] = False
    lines = np.flatnonzero(right)
    if not len(lines):
        return pl.DataFrame(schema=dict.fromkeys(header.columns, pl.String)), lines
    body = (
        data[starts[header.line] :]
        if right[header.line :].all()
        else b"\n".join(data[starts[k] : ends[k]] for k in lines)
    )
    frame = pl.read_csv(
        io.BytesIO(body),
        has_header=False,
        new_columns=header.columns,
        infer_schema=False,
        quote_char=None,
        separator=header.separator,
    )
    return frame, lines + 1


def _quoted(file: str, text: str, header: Header, noted: Noted) -> tuple[pl.DataFrame, Int[np.ndarray, " row"]]:
    """Rows of a table with quoted fields."""
    reader = csv.reader(io.StringIO(text), strict=True, skipinitialspace=True, delimiter=header.separator)
    rows, lines, wrong, line = [], [], [], 1
    try:
        for row in reader:
            if line > header.line and len(row) == len(header.columns):
                rows.append(row)
                lines.append(line)
            elif line > header.line and "".join(row).strip():
                wrong.append((line, row))
            line = reader.line_num + 1
    except csv.Error as error:
        noted.add(file, line, f"the row cannot be read: {error}", "close its quotes")
    _wrong_fields(file, wrong, header, noted)
    schema = dict.fromkeys(header.columns, pl.String)
    return pl.DataFrame(rows, schema=schema, orient="row"), np.array(lines, int)


def write_table(path: Path, columns: Columns) -> None:
    """Writes a table; numbers in the shortest form that reads back to the same value, NaN and "" as an empty field."""
    frame = pl.DataFrame(columns).with_columns(
        pl.selectors.float().fill_nan(None), pl.selectors.string().replace("", None)
    )
    frame.write_csv(path)
