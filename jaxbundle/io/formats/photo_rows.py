"""Rows of photographs of BINGO, PATB and Pix4D: a head, points x y, and -99 at the end of each photograph.

These programs require short names without blanks: other names become numbers, which names.csv explains.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxbundle.io.formats.collected import Collected
from jaxbundle.io.formats.foreign_block import ForeignBlock
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.noted import Noted

END = "-99"
NAME_LENGTH = 15  # characters of a point or photo
NAMES = "names.csv"


def read_photo_rows(
    path: Path, found: Collected, noted: Noted, head: Callable[[int, list[str]], None] = lambda line, fields: None
) -> None:
    """Collects photographs and their rays; `head` takes the line and the fields of a row that begins a photograph."""
    photo = ""
    for line, text in enumerate(lines_of(path), 1):
        fields = text.split()
        if not fields or fields[0].startswith(("#", "*")):
            continue
        if fields[0] == END:
            photo = ""
        elif not photo:
            photo = fields[0]
            found.image(photo)
            head(line, fields)
        elif len(fields) < 3:
            noted.add(path.name, line, f"the row has {len(fields)} fields, not point x y", AGAIN)
        else:
            values = numbers(path, line, fields[1:3], noted)
            if values is not None:
                found.ray(photo, fields[0], values[0], values[1])


def photo_rows(
    foreign: ForeignBlock,
    points: tuple[str, ...],
    head: Callable[[int], str],
    row: Callable[[str, int, float, float], str],
) -> str:
    """The text of all photographs; `head` gives the first row of one, `row` that of a point on the photograph."""
    rays, rows = foreign.rays, []
    order = np.argsort(rays.image, kind="stable")
    ends = np.searchsorted(rays.image[order], np.arange(len(foreign.images.names) + 1)).tolist()
    for k in range(len(foreign.images.names)):
        rows.append(head(k))
        for r in order[ends[k] : ends[k + 1]].tolist():
            rows.append(row(points[rays.point[r]], k, *rays.xy[r].tolist()))
        rows.append(END)
    return "\n".join(rows) + "\n"


def short_names(names: tuple[str, ...], length: int = NAME_LENGTH) -> tuple[tuple[str, ...], bool]:
    """Names without blanks and with few characters; other names become numbers. Returns whether one did."""
    good = all(name and len(name) <= length and not any(c.isspace() for c in name) and name != END for name in names)
    plain = good and not any(name.startswith(("#", "*", "-", "$")) for name in names)
    return (names, False) if plain else (tuple(str(k + 1) for k in range(len(names))), True)


def written_names(
    foreign: ForeignBlock, folder: Path, losses: list[str], length: int = NAME_LENGTH
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Written names of images and points; if some are numbers, names.csv and a sentence explain them."""
    images, renamed = short_names(foreign.images.names, length)
    points, numbered = short_names(foreign.points.names, length)
    if renamed or numbered:
        rows = ["kind,written,name"]
        for kind, own, written in (("image", foreign.images.names, images), ("point", foreign.points.names, points)):
            pairs = zip(own, written, strict=True)
            rows += [f'{kind},{number},"{name}"' for name, number in pairs if name != number]
        (folder / NAMES).write_text("\n".join(rows) + "\n", encoding="utf-8")
        losses.append(f"names of more than {length} characters or with blanks: {NAMES} has their numbers")
    return images, points
