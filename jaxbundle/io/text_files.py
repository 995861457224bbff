"""Reading the text of a file with any encoding and line ends; a file that cannot be read gives one message.

Supported are UTF-8 with or without byte order mark, UTF-16 and UTF-32 with one, and lines that end with LF, CR LF or
CR. Refused are files that are not regular (devices, pipes, folders) and files that would not fit into memory.
"""

import codecs
import os
import stat
from pathlib import Path

from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.noted import Noted

MARKS = (  # UTF-32 before UTF-16: their marks begin with the same bytes
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
MEMORY_A_BYTE = 10  # bytes of memory per byte of a file: text, its bytes, fields as text and as numbers
GIB = 2**30
KNOWN_BYTES = {  # first bytes of files that are not text
    b"\x1f\x8b": "is compressed (gzip)",
    b"BZh": "is compressed (bzip2)",
    b"PK\x03\x04": "is a zip archive, or a table of a spreadsheet program",
    b"\xfd7zXZ": "is compressed (xz)",
    b"\xd0\xcf\x11\xe0": "is a document of an office program",
    b"PAR1": "is a Parquet table",
    b"SQLite format 3": "is a database (SQLite)",
    b"%PDF": "is a PDF document",
    b"\xff\xd8\xff": "is a picture (JPEG)",
    b"\x89PNG": "is a picture (PNG)",
}


class UnreadableError(Exception):
    """A file that cannot be read, with problem and cure."""

    def __init__(self, what: str, cure: str):
        self.what, self.cure = what, cure
        super().__init__(f"{what}; {cure}")


def _memory() -> int:
    """Size of the memory of the machine in bytes."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def file_bytes(path: Path, most: int = 0) -> bytes:
    """The bytes of a regular file, only the first ones if `most` is given.

    Raises: UnreadableError with problem and cure.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise UnreadableError("is not a regular file", "give a regular file")
        if not most and status.st_size * MEMORY_A_BYTE > _memory():
            size, needed, there = (n / GIB for n in (status.st_size, status.st_size * MEMORY_A_BYTE, _memory()))
            what = f"has {size:.1f} GiB; reading it needs about {needed:.0f} GiB of memory, the machine has {there:.0f}"
            raise UnreadableError(what, "divide the block, or read it on a larger machine")
        if not status.st_size:  # such as files of /proc: some of them never end
            return b""
        with path.open("rb") as file:
            return file.read(most or status.st_size)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise UnreadableError("is missing", "add it") from error
    except OSError as error:
        raise UnreadableError(f"cannot be read: {error.strerror}", "correct its name or its access rights") from error
    except ValueError as error:  # such as a NUL in the path
        raise UnreadableError(f"cannot be read: {error}", "correct its name") from error


def require_bytes(path: Path) -> bytes:
    """The bytes of a regular file.

    Raises: BlockError where there is none.
    """
    try:
        return file_bytes(path)
    except UnreadableError as error:
        raise BlockError([Problem(f"{path} {error.what}", error.cure)]) from error


def known_bytes(data: bytes) -> str:
    """Describes a file with these first bytes, if it has a known format that is not text; otherwise ""."""
    return next((what for begin, what in KNOWN_BYTES.items() if data.startswith(begin)), "")


def read_text(path: Path, noted: Noted) -> str | None:
    """The text of a file of a block folder, with LF at the end of each line; None and a note if it cannot be read."""
    noted.files.append(path.name)
    try:
        return _text(file_bytes(path))
    except UnreadableError as error:
        cure = error.cure
        if error.what == "is missing":
            cure = "add it to the folder, or drop its entry in block.toml"
        noted.add(path.name, 0, f"the file {error.what}", cure)
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        what = f"byte 0x{error.object[error.start]:02x} is not {error.encoding.upper()}"
        noted.add(path.name, line, what, "save the file in UTF-8")
    return None


def _text(data: bytes) -> str:
    known = known_bytes(data)
    if known:
        raise UnreadableError(known, "give it as plain text in UTF-8")
    mark, encoding = next(((mark, name) for mark, name in MARKS if data.startswith(mark)), (b"", "utf-8"))
    if not mark and b"\0" in data[:2] and len(data) > 1 and data[:2] != b"\0\0":
        raise UnreadableError("looks like UTF-16 without a byte order mark", "save the file in UTF-8")
    text = data[len(mark) :].decode(encoding) if encoding == "utf-8" else data.decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
