"""Small pictures with many cells as PNG inside the page, and the colour scale of their values."""

import base64
import struct
import zlib

import numpy as np
from jaxtyping import Float, UInt8

# viridis at 0, 1/8, ..., 1: even steps of lightness, suitable for colour-blind readers (van der Walt and Smith 2015)
VIRIDIS = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    float,
)
BLUE, MIDDLE, ORANGE = (0, 90, 156), (247, 247, 244), (196, 80, 11)  # colours of signed values


def viridis(share: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "... 3"]:
    """Colours of values between 0 and 1."""
    place = np.clip(np.nan_to_num(share), 0, 1) * (len(VIRIDIS) - 1)
    low = np.minimum(place.astype(int), len(VIRIDIS) - 2)
    part = (place - low)[..., None]
    return np.round(VIRIDIS[low] * (1 - part) + VIRIDIS[low + 1] * part).astype(np.uint8)


def signed(share: float) -> str:
    """The colour of a value between -1 and 1, blue below 0, orange above."""
    end, part = (ORANGE if share > 0 else BLUE), min(abs(share), 1.0)
    return hexadecimal(tuple(round(m + (e - m) * part) for m, e in zip(MIDDLE, end, strict=True)))


def hexadecimal(colour: tuple[int, ...]) -> str:
    """A colour in the notation of HTML."""
    return "#" + "".join(f"{int(c):02x}" for c in colour)


def png(pixels: UInt8[np.ndarray, "row column 4"]) -> str:
    """A data URL with the picture; the first row is at the top (PNG, ISO/IEC 15948)."""
    rows, columns = pixels.shape[:2]
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), pixels.reshape(rows, -1)], 1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines.tobytes(), 9)),
        (b"IEND", b""),
    )
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    return "data:image/png;base64," + base64.b64encode(data).decode()
