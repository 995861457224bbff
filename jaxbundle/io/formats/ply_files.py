"""Reading the vertices of PLY files, binary or text.

Only vertices are read; they must be the first element of the file.
"""

from pathlib import Path

import numpy as np

from jaxbundle.block.problems import BlockError
from jaxbundle.io.formats.source import wrong

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
END = b"end_header\n"
CURE = "save the project again"


def ply_vertices(path: Path, data: bytes, wanted: tuple[str, ...]) -> np.ndarray:
    """The vertices of a PLY file as a structured array; `path` is for messages.

    Raises: BlockError for another format, or where the file ends too early.
    """
    data = data.replace(b"\r\n", b"\n", 20) if data[:5] == b"ply\r\n" else data
    head, found, body = data.partition(END)
    lines = head.decode("latin-1").split("\n")
    if not found or lines[0].strip() != "ply":
        raise wrong(path, 0, "a file of points is not PLY", CURE)
    words = lines[1].split() if len(lines) > 1 else []
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1] if len(words) > 1 else "", "")
    count, fields = _header(path, lines, order or "<")
    names = [name for name, _ in fields]
    if not set(wanted) <= set(names):
        raise wrong(path, 0, f"a PLY file has {', '.join(names)}, not {', '.join(wanted)}", CURE)
    form = np.dtype(fields)
    if order:
        if len(body) < count * form.itemsize:
            raise wrong(path, 0, f"a PLY file ends before its {count} vertices", CURE)
        return np.frombuffer(body, form, count)
    rows = [tuple(line.split()[: len(names)]) for line in body.decode("latin-1").split("\n")[:count]]
    try:
        return np.array(rows, [(name, "f8") for name in names])
    except ValueError as error:
        raise wrong(path, 0, "a PLY file has vertices that are not numbers", CURE) from error


def _header(path: Path, lines: list[str], order: str) -> tuple[int, list[tuple[str, str]]]:
    """Number of vertices and their fields; vertices must be the first element."""
    count, fields, element = -1, [], ""
    for line in lines:
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3:
            element = words[1] if count < 0 or words[1] == "vertex" else "other"
            if element == "vertex" and words[2].isdigit() and len(words[2]) < 12:
                count = int(words[2])
        elif words[:1] == ["property"] and element == "vertex":
            if len(words) != 3 or words[1] not in TYPES:
                raise _unknown(path, line)
            fields.append((words[2], order + TYPES[words[1]]))
    if count < 0 or not fields or len({name for name, _ in fields}) < len(fields):
        raise wrong(path, 0, "a PLY file does not describe its vertices", CURE)
    return count, fields


def _unknown(path: Path, line: str) -> BlockError:
    return wrong(path, 0, f"a PLY file has vertices of the unknown kind '{line[:60]}'", CURE)
