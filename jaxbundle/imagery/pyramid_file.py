"""Image pyramids in files: a tiled TIFF with one sub-image for each level, made once and reused.

The levels are SubIFDs with tiles of 256 x 256 pixels, which GDAL reads as overviews. The description contains the
source of the pyramid: size, time and SHA-256 of the file, and the rule of the mean.
"""

import hashlib
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxbundle.imagery.extra import required
from jaxbundle.imagery.levels import grey, halved, level_sizes
from jaxbundle.imagery.photographs import Photograph, photograph, strips
from jaxbundle.numerics.whole_files import write_whole

TILE = 256  # px; even, so that strips of a row of tiles can be halved separately
VERSION = 1
RULE = "mean of 2 x 2, half up, edge repeated"
FOLDER = "pyramids"
BLOCK = 1 << 20  # bytes per read


@dataclass(frozen=True)
class Pyramid:
    """A pyramid in a file. Level 0 is the photograph itself.

    Example:
        >>> jb.imagery.pyramid("photo.png").sizes[:2]
        ((35, 35),)
    """

    path: Path
    """The tiled TIFF."""
    source: str
    """Name of the photograph."""
    sizes: tuple[tuple[int, int], ...]
    """Rows and columns of each level."""
    channels: int
    """1 of a grey image, 3 of a colour image."""

    def size(self, level: int) -> tuple[int, int]:
        """Rows and columns of a level.

        Raises: ValueError for a level that the pyramid does not have.
        """
        if not 0 <= level < len(self.sizes):
            raise ValueError(f"{self.source} has levels 0 to {len(self.sizes) - 1}, not {level}")
        return self.sizes[level]

    def window(self, level: int, first: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
        """Pixels of a part of a level; only its tiles are read.

        Args:
            level: 0 for the photograph itself.
            first: row and column of the first pixel.
            size: rows and columns.

        Returns: (row, column), for a colour image (row, column, channel).

        Raises: ValueError for a level or a window outside the pyramid.
        """
        last = first[0] + size[0], first[1] + size[1]
        rows, columns = self.size(level)
        if min(first) < 0 or min(size) < 1 or last[0] > rows or last[1] > columns:
            raise ValueError(
                f"rows {first[0]} to {last[0]}, columns {first[1]} to {last[1]} exceed level {level} of {self.source},"
                f" which has {rows} rows and {columns} columns"
            )
        with required("tifffile").TiffFile(self.path) as file:
            page = file.pages[0] if level == 0 else file.pages[0].pages[level - 1]
            return _window(page, file.filehandle, first, size)

    def level(self, level: int) -> np.ndarray:
        """All pixels of a level."""
        return self.window(level, (0, 0), self.size(level))

    def grey(self, level: int) -> np.ndarray:
        """Grey values of a level in double precision."""
        return grey(self.level(level))


def pyramid(path: str | Path, folder: str | Path | None = None, *, compression: str | None = None) -> Pyramid:
    """The image pyramid of a photograph, from an existing file or newly made.

    Args:
        path: JPEG, PNG or TIFF, 8 to 16 bit, grey or colour. A TIFF may be larger than the memory.
        folder: folder of the pyramids; by default `pyramids` in the folder of the photograph.
        compression: compression of the tiles, None or "zlib".

    Returns: the pyramid; windows are read separately.

    Raises: ImageError for an incomplete image; OSError if the pyramid cannot be written.

    Example:
        >>> jb.imagery.pyramid("photo.png").level(0).shape
        (35, 35)
    """
    path = Path(path)
    folder = path.parent / FOLDER if folder is None else Path(folder)
    file = folder / f"{path.name}.tif"
    found = _found(file, path)
    if found is not None:
        return found
    image = photograph(path)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(file, lambda opened: _write(opened, image, folder, compression))
    return Pyramid(file, path.name, level_sizes(image.rows, image.columns), image.channels)


def source_hash(path: Path) -> str:
    """SHA-256 of a file."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _found(file: Path, source: Path) -> Pyramid | None:
    """The pyramid of a file, if it was made from this source with this rule."""
    if not file.is_file():
        return None
    tifffile = required("tifffile")
    try:
        with tifffile.TiffFile(file) as opened:
            key = json.loads(opened.pages[0].description)
            page = opened.pages[0]
            shapes = [page.shape, *(level.shape for level in page.pages or ())]
    except (OSError, ValueError, tifffile.TiffFileError):
        return None
    if not isinstance(key, dict) or (key.get("version"), key.get("rule")) != (VERSION, RULE):
        return None
    status = source.stat()
    same = (key.get("bytes"), key.get("mtime_ns")) == (status.st_size, status.st_mtime_ns)
    if not same and (key.get("bytes") != status.st_size or key.get("sha256") != source_hash(source)):
        return None
    sizes = tuple((int(shape[0]), int(shape[1])) for shape in shapes)
    return Pyramid(file, source.name, sizes, 1 if len(shapes[0]) == 2 else int(shapes[0][2]))


def _write(opened: BinaryIO, image: Photograph, folder: Path, compression: str | None) -> None:
    """Writes all levels; each level is halved strip by strip during writing."""
    status = image.path.stat()
    key = {
        "version": VERSION,
        "rule": RULE,
        "source": image.path.name,
        "bytes": status.st_size,
        "mtime_ns": status.st_mtime_ns,
        "sha256": source_hash(image.path),
    }
    sizes = level_sizes(image.rows, image.columns)
    options: dict[str, Any] = {
        "dtype": image.dtype,
        "tile": (TILE, TILE),
        "photometric": "rgb" if image.channels == 3 else "minisblack",
        "compression": compression,
        "metadata": None,
    }
    large = image.rows * image.columns * image.channels * image.dtype.itemsize > 2**32 - 2**28
    with tempfile.TemporaryDirectory(dir=folder, prefix=".levels-") as beside:
        with required("tifffile").TiffWriter(opened, bigtiff=large) as writer:
            rows_of_level = strips(image, TILE)
            for level, size in enumerate(sizes):
                shape = size if image.channels == 1 else (*size, image.channels)
                following = None
                if level + 1 < len(sizes):
                    following = _on_disk(Path(beside) / f"{level + 1}", sizes[level + 1] + shape[2:], image.dtype)
                own = {"subifds": len(sizes) - 1, "description": json.dumps(key)} if level == 0 else {}
                own |= {"subfiletype": 1} if level else {}
                writer.write(_tiles(rows_of_level, following), shape=shape, **options, **own)
                if following is not None:
                    rows_of_level = _rows_of(following)


def _on_disk(path: Path, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    return np.memmap(path, dtype, "w+", shape=shape)


def _rows_of(image: np.ndarray) -> Iterator[np.ndarray]:
    for first in range(0, len(image), TILE):
        yield image[first : first + TILE]


def _tiles(rows_of_level: Iterator[np.ndarray], following: np.ndarray | None) -> Iterator[np.ndarray]:
    """The tiles of a level, row by row; the means of each row of tiles are passed to the next level."""
    first = 0
    for strip in rows_of_level:
        if following is not None:
            mean = halved(strip)
            following[first : first + len(mean)] = mean
            first += len(mean)
        rows, columns = strip.shape[:2]
        pad = [(0, -rows % TILE), (0, -columns % TILE)] + [(0, 0)] * (strip.ndim - 2)
        padded = np.pad(strip, pad, mode="edge")
        for column in range(0, columns, TILE):
            yield np.ascontiguousarray(padded[:, column : column + TILE])


def _window(page: Any, handle: Any, first: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    across = -(-page.imagewidth // TILE)
    result = np.empty((*size, page.samplesperpixel), page.dtype)
    last = first[0] + size[0], first[1] + size[1]
    for i in range(first[0] // TILE, -(-last[0] // TILE)):
        for j in range(first[1] // TILE, -(-last[1] // TILE)):
            number = i * across + j
            handle.seek(page.dataoffsets[number])
            tile = page.decode(handle.read(page.databytecounts[number]), number)[0][0]
            top, left = max(first[0], i * TILE), max(first[1], j * TILE)
            bottom, right = min(last[0], (i + 1) * TILE), min(last[1], (j + 1) * TILE)
            part = tile[top - i * TILE : bottom - i * TILE, left - j * TILE : right - j * TILE]
            result[top - first[0] : bottom - first[0], left - first[1] : right - first[1]] = part
    return result[..., 0] if page.samplesperpixel == 1 else result
