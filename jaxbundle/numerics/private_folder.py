"""Private folders: only the user can write to them, so it is safe to run compiled programs from them."""

import os
import stat
from pathlib import Path

_OF_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def private_folder(path: Path) -> Path | None:
    """The folder, which is created if missing; None if it is not private.

    It must be a folder, not a link, that belongs to the effective user, and neither group nor others may write to
    it. No folder is created in a folder of another user: root with the HOME of a user would lock that user out.
    """
    missing = [folder for folder in (path, *path.parents) if not os.path.lexists(folder)]
    above = missing[-1].parent if missing else path
    try:
        if missing and os.name == "posix" and above.stat().st_uid not in (0, os.geteuid()):
            return None
        for folder in reversed(missing):
            folder.mkdir(mode=0o700, exist_ok=True)
        status = path.lstat()
    except OSError:
        return None
    return path if stat.S_ISDIR(status.st_mode) and is_private(status) else None


def is_private(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to the effective user, and nobody else may write to it."""
    if os.name != "posix":
        return True  # on Windows, access lists make the folders of a user's profile private
    return status.st_uid == os.geteuid() and not status.st_mode & _OF_OTHERS


def read_private(path: Path) -> bytes | None:
    """The content of a file that only the user may write to; None if there is none."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        return file.read() if stat.S_ISREG(status.st_mode) and is_private(status) else None


def trim(folder: Path, limit: int) -> None:
    """Deletes the least recently used files below a folder until the rest fits `limit` bytes."""
    files = []
    for parent, _, names in os.walk(folder):
        for path in (os.path.join(parent, name) for name in names):
            try:
                status = os.lstat(path)
            except OSError:
                continue
            if stat.S_ISREG(status.st_mode):
                files.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= limit:
            return
        try:
            os.unlink(path)
        except OSError:
            continue
        total -= size
