"""Files of finished pairs of images, so that an interrupted measurement finds them again.

A file has the matches of one pair, and a key of everything that they depend on. Another key means another measurement,
and the pair is remeasured.
"""

import hashlib
import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxbundle.numerics.whole_files import write_whole

VERSION = 1  # of the way in which pairs are verified
FOLDER = "pairs"  # in the folder of the pyramids


def digest(*arrays: np.ndarray) -> str:
    """SHA-256 of the values of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def stored_pair(file: Path, key: str) -> Int[np.ndarray, "match 2"] | None:
    """The matches of a finished pair, or None for a pair that is not finished, or was measured in another way."""
    try:
        with np.load(file) as stored:
            return stored["matches"] if str(stored["key"]) == key else None
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None  # the file is missing or incomplete


def store_pair(file: Path, key: str, matches: Int[np.ndarray, "match 2"]) -> None:
    """Writes the matches of a finished pair."""
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, lambda opened: np.savez(opened, key=key, matches=matches))
