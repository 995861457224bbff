"""Files of photographs: headers, and pixels in strips.

JPEG and PNG are read by Pillow, which decodes an image as a whole. TIFF is read by tifffile, segment by segment, so
that a scanned photograph may be larger than the memory. The pixels are used as stored: an orientation in the EXIF data
is not applied, since a camera's interior orientation belongs to the stored image.
"""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxbundle.block.problems import Problem
from jaxbundle.imagery.extra import required
from jaxbundle.imagery.image_problems import ImageError

TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # classic and BigTIFF, both byte orders
TYPES = ("uint8", "uint16", "float32")
AS_IS = {
    "L": (np.uint8, 1),
    "RGB": (np.uint8, 3),
    "I;16": (np.uint16, 1),
}  # supported modes of Pillow; others are converted
ORIENTATION = 274  # EXIF tag of the orientation


@dataclass(frozen=True)
class Photograph:
    """An image file and its size.

    Example:
        >>> jb.imagery.photograph("photo.png").shape
        (35, 35)
    """

    path: Path
    """Path of the file."""
    rows: int
    """Height in px."""
    columns: int
    """Width in px."""
    channels: int
    """1 for a grey image, 3 for a colour image."""
    dtype: np.dtype
    """Data type of a grey value."""
    orientation: int = 1
    """Orientation of the EXIF data; 1: the image is stored upright."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, columns and, for a colour image, channels."""
        return (self.rows, self.columns) if self.channels == 1 else (self.rows, self.columns, self.channels)


def unreadable(path: Path, what: object) -> ImageError:
    """The error for a file that is not an image."""
    return ImageError([Problem(f"is not a readable image ({what})", "give a whole JPEG, PNG or TIFF file", str(path))])


def photograph(path: str | Path) -> Photograph:
    """Reads the header of an image file.

    Raises: ImageError for a file that is not an image; FileNotFoundError.

    Example:
        >>> photo = jb.imagery.photograph("photo.png")
        >>> photo.rows, photo.columns, photo.channels
        (35, 35, 1)
    """
    path = Path(path)
    with open(path, "rb") as file:
        head = file.read(4)
    try:
        return _tiff(path) if head in TIFF else _with_pillow(path)
    except ImageError:
        raise
    except (OSError, ValueError, SyntaxError) as error:
        raise unreadable(path, error) from error


def strips(image: Photograph, height: int) -> Iterator[np.ndarray]:
    """The pixels from top to bottom, in strips of `height` rows; the last one may be lower.

    Raises: ImageError for a truncated or damaged file.
    """
    with open(image.path, "rb") as file:
        head = file.read(4)
    parts = _tiff_parts(image) if head in TIFF else _pillow_parts(image)
    try:
        yield from _in_strips(parts, height)
    except (OSError, ValueError, SyntaxError, IndexError) as error:
        raise unreadable(image.path, error) from error


def pixels(image: Photograph) -> np.ndarray:
    """All pixels of the image."""
    return np.concatenate(list(strips(image, image.rows)))


def _in_strips(parts: Iterable[np.ndarray], height: int) -> Iterator[np.ndarray]:
    waiting: list[np.ndarray] = []
    count = 0
    for part in parts:
        waiting.append(part)
        count += len(part)
        if count >= height:
            whole = waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
            full = count // height * height
            for first in range(0, full, height):
                yield whole[first : first + height]
            waiting, count = ([whole[full:]] if count > full else []), count - full
    if waiting:
        yield np.concatenate(waiting)


@contextmanager
def of_any_size(module: Any) -> Iterator[None]:
    """Opens an image with Pillow without its limit of pixels, which scanned photographs exceed."""
    limit = module.MAX_IMAGE_PIXELS
    module.MAX_IMAGE_PIXELS = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # corrupt EXIF data do not matter for the pixels
            yield
    finally:
        module.MAX_IMAGE_PIXELS = limit


def _with_pillow(path: Path) -> Photograph:
    module = required("PIL.Image")
    with of_any_size(module), module.open(path) as opened:
        dtype, channels = AS_IS.get(_mode(opened), (np.uint8, 3))
        orientation = int(opened.getexif().get(ORIENTATION, 1) or 1)
        return Photograph(path, opened.height, opened.width, channels, np.dtype(dtype), orientation)


def _mode(opened: Any) -> str:
    """The mode in which the pixels are read."""
    if opened.mode in AS_IS:
        return opened.mode
    if opened.mode.startswith("I"):
        return "I;16"
    return "L" if opened.mode in ("1", "LA") else "RGB"


def _pillow_parts(image: Photograph) -> Iterator[np.ndarray]:
    module = required("PIL.Image")
    with of_any_size(module), module.open(image.path) as opened:
        mode = _mode(opened)
        opened.load()
        if mode == "I;16":
            yield np.asarray(opened).astype(np.uint16)
        else:
            yield np.asarray(opened if opened.mode == mode else opened.convert(mode))


def _tiff(path: Path) -> Photograph:
    with required("tifffile").TiffFile(path) as file:
        page = file.pages[0]
        dtype = np.dtype(page.dtype)
        if dtype.name not in TYPES:
            raise unreadable(path, f"its grey values are of type {dtype.name}")
        tag = page.tags.get(ORIENTATION)
        channels = 1 if page.samplesperpixel < 3 else 3
        orientation = int(tag.value) if tag is not None else 1
        return Photograph(path, page.imagelength, page.imagewidth, channels, dtype, orientation)


def _tiff_parts(image: Photograph) -> Iterator[np.ndarray]:
    """Iterates over rows of segments: strips, or rows of tiles."""
    with required("tifffile").TiffFile(image.path) as file:
        page = file.pages[0]
        separate = page.planarconfig == 2 and page.samplesperpixel > 1
        if separate:
            yield _channels(np.moveaxis(page.asarray(), 0, -1), image)
            return
        band, top = None, 0
        for segment, index, _ in page.segments():
            row, column = index[2], index[3]
            if band is None or row != top:
                if band is not None:
                    yield _channels(band, image)
                height = min(page.tilelength if page.is_tiled else page.rowsperstrip, image.rows - row)
                band, top = np.zeros((height, image.columns, page.samplesperpixel), image.dtype), row
            if segment is not None:  # an empty segment is black
                part = segment[0, : len(band), : image.columns - column]  # a tile at the border is padded
                band[: len(part), column : column + part.shape[1]] = part
        if band is not None:
            yield _channels(band, image)


def _channels(band: np.ndarray, image: Photograph) -> np.ndarray:
    return band[..., 0] if image.channels == 1 else band[..., : image.channels]
