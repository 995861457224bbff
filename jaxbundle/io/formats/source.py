"""Reading text, JSON and XML files of foreign formats; each problem is reported with file and line."""

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ValidationError

from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.io.noted import Noted
from jaxbundle.io.ranges import MAX_LENGTH
from jaxbundle.io.text_files import require_bytes

AGAIN = "correct it, or export it again"
SHOWN_ERRORS = 20  # maximum number of problems of one JSON file
MAX_NUMBER = 1e30  # of any number: its square and its weight stay in the range of float64


def wrong(path: Path, line: int, what: str, cure: str = AGAIN) -> BlockError:
    """An error at one line that ends reading."""
    noted = Noted()
    noted.add(path.name, line, what, cure)
    return noted.error()


def text_of(path: Path) -> str:
    """The text of a file with LF at the end of each line: UTF-8, else Latin-1 of older programs."""
    data = require_bytes(path)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            text = data.decode("utf-16")
        except UnicodeDecodeError as error:
            raise wrong(
                path, 0, "the file is not UTF-16, although its first bytes indicate that", "save it in UTF-8"
            ) from error
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def lines_of(path: Path) -> list[str]:
    """The lines of a text file without their ends."""
    return text_of(path).split("\n")


def numbers(path: Path, line: int, fields: Sequence[str], noted: Noted, what: str = "") -> list[float] | None:
    """Fields of a line as finite numbers; None and a note where one is not a number."""
    values = []
    for field in fields:
        try:
            value = float(field)
        except ValueError:
            value = math.nan
        if not abs(value) < MAX_NUMBER or "_" in field:
            told = f"{what}: " if what else ""
            noted.add(path.name, line, f"{told}'{shown(field)}' is not a finite number", AGAIN)
            return None
        values.append(value)
    return values


def integer(path: Path, line: int, field: str, noted: Noted, what: str) -> int | None:
    """A field as a whole number that is not negative; otherwise None and a note."""
    if field.isascii() and field.isdigit() and len(field) < 19:
        return int(field)
    noted.add(path.name, line, f"{what} '{shown(field)}' is not a whole number", AGAIN)
    return None


def json_of(path: Path) -> Any:
    """The content of a JSON file.

    Raises: BlockError where it is not JSON, with its line.
    """
    try:
        return json.loads(text_of(path))
    except json.JSONDecodeError as error:
        raise wrong(path, error.lineno, f"this is not JSON: {error.msg}") from error
    except (RecursionError, ValueError) as error:
        raise wrong(path, 0, f"this is not JSON that can be read: {shown(str(error))}") from error


def validated(path: Path, model: type[BaseModel], content: Any) -> Any:
    """JSON content as a typed model.

    Raises: BlockError with all values that do not fit, each with its path in the file.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        noted = Noted()
        for detail in error.errors()[:SHOWN_ERRORS]:
            place = shown(".".join(map(str, detail["loc"])) or "the file")
            noted.add(path.name, 0, f"{place}: {shown(detail['msg'], 200)}", AGAIN)
        raise noted.error() from error


def elements(path: Path, *tags: str) -> Iterator[tuple[str, ElementTree.Element]]:
    """Iterates over the elements of an XML file with one of these tags.

    Each element is yielded when it is complete and then deleted: a file of any size needs the memory of one element.
    `root` as tag: the root, when it begins.

    Raises: BlockError where the file is not XML, or has a document type, which is not read for safety.
    """
    if not path.is_file():
        raise BlockError([Problem(f"{shown(str(path))} is not a regular file", "give an XML file")])
    depth: list[ElementTree.Element] = []
    try:
        with path.open("rb") as file:
            if b"<!DOCTYPE" in file.read(4096):
                raise wrong(path, 0, "the file has a document type (<!DOCTYPE), which is not read", "remove it")
            file.seek(0)
            for event, element in ElementTree.iterparse(file, events=("start", "end")):
                if event == "start":
                    depth.append(element)
                    if len(depth) == 1 and "root" in tags:
                        yield "root", element
                    continue
                depth.pop()
                tag = local(element)
                if tag in tags:
                    yield tag, element
                    if not any(local(above) in tags for above in depth):
                        element.clear()
                        if depth:
                            depth[-1].remove(element)
    except ElementTree.ParseError as error:
        line = error.position[0]
        raise wrong(path, line, f"this is not XML that can be read: {shown(str(error))}") from error
    except (LookupError, ValueError, OSError) as error:
        if isinstance(error, BlockError):
            raise
        raise wrong(path, 0, f"this is not XML that can be read: {shown(str(error))}") from error


def tree_of(path: Path, data: bytes | None = None) -> ElementTree.Element:
    """The root of a small XML file, or of one within an archive.

    Raises: BlockError where it is not XML, or has a document type.
    """
    data = require_bytes(path) if data is None else data
    if b"<!DOCTYPE" in data:
        raise wrong(path, 0, "the file has a document type (<!DOCTYPE), which is not read", "remove it")
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise wrong(path, error.position[0], f"this is not XML that can be read: {shown(str(error))}") from error
    except (LookupError, ValueError) as error:
        raise wrong(path, 0, f"this is not XML that can be read: {shown(str(error))}") from error


def local(element: ElementTree.Element) -> str:
    """The tag of an element without its namespace."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def child_text(element: ElementTree.Element | None, path: str) -> str:
    """The text of a descendant, blanks stripped; "" where there is none."""
    found = None if element is None else element.find(path)
    return (found.text or "").strip() if found is not None else ""


class XmlNumbers:
    """Reads numbers of an XML file; text that is not a number is noted with its element."""

    def __init__(self, path: Path, noted: Noted):
        self.path, self.noted = path, noted

    def of_text(self, text: str, what: str, absent: float = math.nan) -> float:
        """A number in text; `absent` where there is none."""
        if not text:
            return absent
        values = numbers(self.path, 0, [text], self.noted, what)
        return values[0] if values else absent

    def of(self, element: ElementTree.Element | None, path: str, what: str, absent: float = math.nan) -> float:
        """The number in a descendant; `absent` where there is none."""
        return self.of_text(child_text(element, path), f"{what}, {path}", absent)

    def attribute(self, element: ElementTree.Element, name: str, what: str, absent: float = math.nan) -> float:
        """The number in an attribute; `absent` where there is none."""
        return self.of_text((element.get(name) or "").strip(), f"{what}, {name}", absent)

    def array(self, text: str, count: int, what: str) -> Float[np.ndarray, " number"] | None:
        """An array with the expected number of values; None and a note where the number differs."""
        fields = text.split()
        if len(fields) != count:
            self.noted.add(self.path.name, 0, f"{what} has {len(fields)} numbers, not {count}", AGAIN)
            return None
        values = numbers(self.path, 0, fields, self.noted, what)
        return None if values is None else np.array(values)


def require_lengths(path: Path, what: str, values: Float[np.ndarray, "..."]) -> None:
    """Raises BlockError where a coordinate is infinite or too large; NaN means unknown."""
    bad = ~(np.isnan(values) | (np.abs(np.nan_to_num(values, posinf=np.inf)) <= MAX_LENGTH))
    if bad.any():
        raise wrong(path, 0, f"{int(bad.sum())} of the {what} are infinite or larger than {MAX_LENGTH:g}")
