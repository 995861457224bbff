"""Blocks in files made wrong at random: bytes, cells, headers, rows, whole files and values of block.toml.

A folder is a dictionary of file names and contents; a `Special` stands for what is no plain file.
"""

import gzip
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

Rng = np.random.Generator


class Special(NamedTuple):
    """What is put in the place of a file: "folder", "pipe", "nothing", or a link to another path."""

    kind: str


Files = dict[str, bytes | Special]
VALUES = (
    ["", " ", "0", "-0", "1", "-1", "1e308", "-1e308", "1e-320", "1e-400", "1e400", "nan", "inf", "-inf", "1e5", "1,5"]
    + ["1'000", "1_000", "1.5.5", "0x10", "1e", "abc", "\x00", "\x1b[31m", "\u202e", "\ufeff", "a\nb", '"', '""', "'"]
    + ["=1+1", "image:", "image:011", "101", "011", "9" * 400, "a" * 5000, "é", "１", "check", "control", "Control"]
    + [
        "\u2028",
        "\ud7ff",
        "1e-15",
        "1e12",
        "1e13",
        "100000000000000000000000000000",
        "-5",
        "0.5",
        "3.14",
        ";",
        "\t",
        ",",
    ]
)
TOML = (
    ["true", "false", "0", "-1", "1", "2", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", '""', '"m"', '"MM"', "[]"]
    + ["[1]", "[1.0, 2.0]", "[[1]]", "{}", "{ a = 1 }", "07:32:00", "1979-05-27", "1979-05-27T07:32:00Z", '"../x.csv"']
    + [
        '"/etc/passwd"',
        '"\\u0000"',
        '"\\u001b[0m"',
        '"\\u202e"',
        '"a\\nb"',
        "0x1F",
        "1_000",
        "'''x'''",
        '"' + "a" * 5000,
    ]
    + [
        '"' + "a" * 300 + '"',
        "10000000000000000000000000000000000000000",
        "9" * 5000,
        "[" * 2000,
        "abc",
        "1.5",
        '"all"',
    ]
    + ['"omega-phi-kappa"', '"none"', '"brown"', '"metashape"', '"bal"', '"ebner"', '["x0", "K1"]', "{ K1 = 1e300 }"]
    + ['"images.csv"', '"rays.csv"', '"block.toml"', '"."', '"inner"', '"fixed"', '"minimal"', '"affine"', "1e-7"]
)


def _line_of(rng: Rng, lines: list[bytes]) -> int:
    return int(rng.integers(len(lines)))


def bytes_changed(data: bytes, rng: Rng) -> bytes:
    """Some bytes set, taken out, put in or repeated."""
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(raw) + 1))
        match int(rng.integers(5)):
            case 0 if at < len(raw):
                raw[at] = int(rng.integers(256))
            case 1:
                del raw[at : at + int(rng.integers(1, 20))]
            case 2:
                raw[at:at] = rng.bytes(int(rng.integers(1, 5)))
            case 3:
                raw[at:at] = raw[at : at + int(rng.integers(1, 200))]
            case _:
                raw[at:at] = bytes(rng.choice([*b",;\t\n\r\"'.-+ e0#[]={}"], 2).astype(np.uint8))
    return bytes(raw)


def cell_changed(data: bytes, rng: Rng) -> bytes:
    """A field of a row, or of the header, set to another value; or a whole column."""
    lines = data.split(b"\n")
    value = str(rng.choice(VALUES)).encode("utf-8", "surrogatepass")
    at, column = _line_of(rng, lines), int(rng.integers(9))
    rows = range(1, len(lines)) if rng.random() < 0.15 else (at,)
    for row in rows:
        fields = lines[row].split(b",")
        if len(fields) > 1:
            fields[column % len(fields)] = value
            lines[row] = b",".join(fields)
    return b"\n".join(lines)


def header_changed(data: bytes, rng: Rng) -> bytes:
    """A column renamed, dropped, given twice or in other case; or another separator."""
    head, _, rest = data.partition(b"\n")
    fields = head.split(b",")
    at = int(rng.integers(len(fields)))
    match int(rng.integers(6)):
        case 0:
            fields[at] = str(rng.choice(VALUES)).encode("utf-8", "surrogatepass")
        case 1:
            del fields[at]
        case 2:
            fields.insert(at, fields[at])
        case 3:
            fields[at] = fields[at].swapcase()
        case 4:
            fields = fields[::-1]
        case _:
            separator = bytes(rng.choice(list(b";\t| "), 1).astype(np.uint8))
            text = data.replace(b",", separator)
            return text.replace(b".", b",") if rng.random() < 0.5 else text
    return b",".join(fields) + b"\n" + rest


def rows_changed(data: bytes, rng: Rng) -> bytes:
    """Rows repeated, taken out, exchanged, cut, or many of them empty."""
    lines = data.split(b"\n")
    i, j = _line_of(rng, lines), _line_of(rng, lines)
    match int(rng.integers(7)):
        case 0:
            lines.insert(j, lines[i])
        case 1:
            del lines[min(i, j) : max(i, j)]
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case 3:
            lines = lines[: i + 1]
        case 4:
            lines[i] = lines[i][: len(lines[i]) // 2]
        case 5:
            lines[i:i] = [b"," * int(rng.integers(1, 9))] * int(rng.integers(1, 2000))
        case _:
            lines = lines[:1] + [lines[k] for k in rng.permutation(np.arange(1, len(lines)))]
    return b"\n".join(lines)


def file_changed(data: bytes, rng: Rng) -> bytes | Special:
    """A whole file in another form, or something else in its place."""
    text = data.decode("utf-8", "replace")
    changes: list[Callable[[], bytes | Special]] = [
        lambda: b"",
        lambda: b"\n",
        lambda: b"\x00" * 100,
        lambda: rng.bytes(200),
        lambda: gzip.compress(data),
        lambda: b"\xef\xbb\xbf" + data,
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-16-le"),
        lambda: text.encode("utf-32"),
        lambda: text.replace("1", "é").encode("latin-1", "replace"),
        lambda: data.replace(b"\n", b"\r\n"),
        lambda: data.replace(b"\n", b"\r"),
        lambda: data.replace(b"\n", b","),
        lambda: data.replace(b",", b"\n"),
        lambda: data + b"x" * 100_000,
        lambda: b"," * 100_000,
        lambda: data + b'"' + data,
        lambda: data * 3,
        lambda: data[: int(rng.integers(len(data) + 1))],
        *(
            lambda kind=kind: Special(kind)
            for kind in ("nothing", "folder", "pipe", "/dev/zero", "/proc/self/mem", ".")
        ),
    ]
    return changes[int(rng.integers(len(changes)))]()


def toml_changed(data: bytes, rng: Rng) -> bytes:
    """A value set to another one; a line taken out, repeated or moved; a section or an unknown key more."""
    lines = data.split(b"\n")
    at = _line_of(rng, lines)
    match int(rng.integers(6)):
        case 0 | 1 | 2:
            keys = [k for k, line in enumerate(lines) if b"=" in line]
            if keys:
                at = int(rng.choice(keys))
                lines[at] = lines[at].partition(b"=")[0] + b"= " + str(rng.choice(TOML)).encode()
        case 3:
            del lines[at]
        case 4:
            lines.insert(_line_of(rng, lines), lines[at])
        case _:
            more = [b"[datum]\ntype = ", b"[navigation.a]\nshift = ", b"[x]\ny = ", b"z = ", b"[sigma]\nimage = "]
            lines.insert(at, more[int(rng.integers(len(more)))] + str(rng.choice(TOML)).encode())
    return b"\n".join(lines)


def folder_mutated(files: dict[str, bytes], rng: Rng) -> Files:
    """The files that differ from those of a folder: one to three of them, each made wrong once or twice."""
    changed: Files = {}
    for name in rng.choice(sorted(files), int(rng.choice([1, 1, 1, 2, 3])), replace=False):
        data: bytes | Special = files[name]
        for _ in range(int(rng.choice([1, 1, 2]))):
            if isinstance(data, bytes):
                tables = (bytes_changed, cell_changed, cell_changed, header_changed, rows_changed, file_changed)
                ways = (bytes_changed, toml_changed, toml_changed, toml_changed, file_changed)
                chosen = ways if name.endswith(".toml") else tables
                data = chosen[int(rng.integers(len(chosen)))](data, rng)
        changed[str(name)] = data
    return changed


def bal_mutated(data: bytes, rng: Rng) -> bytes:
    """A BAL file with some fields or bytes made wrong."""
    if rng.random() < 0.5:
        return bytes_changed(data, rng)
    fields = data.replace(b"\n", b" \n ").split(b" ")
    for _ in range(int(rng.integers(1, 4))):
        value = str(rng.choice([value for value in VALUES if value != "\ud7ff"])).encode()
        fields[int(rng.integers(len(fields)))] = value
    return b" ".join(fields)


def put(folder: Path, files: Files) -> None:
    """Writes files into a folder, in the place of what is there."""
    for name, data in files.items():
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
        if isinstance(data, bytes):
            path.write_bytes(data)
        elif data.kind == "folder":
            path.mkdir()
        elif data.kind == "pipe":
            os.mkfifo(path)
        elif data.kind != "nothing":
            path.symlink_to(data.kind)
