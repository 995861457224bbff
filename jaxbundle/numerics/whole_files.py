"""Files that are written under a temporary name and renamed when they are complete.

Temporary names contain their process: `.jaxbundle-MACHINE-PID-START-RANDOM`. So remnants of a killed process can be
distinguished from files that another process is writing.
"""

import hashlib
import os
import platform
import re
import secrets
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import BinaryIO

PREFIX = ".jaxbundle-"
_MARKED = re.compile(re.escape(PREFIX) + r"([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{8}")
_PROCESSES = Path("/proc")
FORGOTTEN = 86_400.0  # seconds: processes on other machines cannot be looked up, but no report takes a day to write


def marked_name() -> str:
    """A new hidden name that contains its process."""
    return f"{PREFIX}{_machine()}-{os.getpid()}-{_start(os.getpid()) or 0}-{secrets.token_hex(4)}"


def remnants(folder: Path) -> list[Path]:
    """Files and folders of this user that an ended process left in a folder."""
    try:
        names = os.listdir(folder)
    except OSError:
        return []
    return [folder / name for name in sorted(names) if _is_remnant(folder / name)]


def belongs_to_user(path: Path) -> bool:
    """Whether the user of this process owns a file or folder; a link is not followed. False where there is none."""
    try:
        return not hasattr(os, "geteuid") or path.lstat().st_uid == os.geteuid()
    except OSError:
        return False


def write_whole(path: Path, write: Callable[[BinaryIO], object], mode: int = 0o666) -> None:
    """Writes a file under a temporary name, flushes it to the disk and renames it; removes it after a failure.

    `mode`: its permissions, reduced by the user's mask. Raises: OSError if the folder cannot be written.
    """
    for remnant in remnants(path.parent):
        if not remnant.is_dir():
            remnant.unlink(missing_ok=True)
    beside = path.parent / marked_name()
    try:
        # a new file, so that links of other users are not followed
        with open(beside, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_file(path: Path) -> None:
    """Flushes a file to the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path: Path) -> None:
    """Flushes the names in a folder to the disk, if the file system supports it."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return  # Windows cannot open folders
    try:
        os.fsync(descriptor)
    except OSError:
        pass  # some network file systems cannot flush folders
    finally:
        os.close(descriptor)


@cache
def _machine() -> str:
    """Identifier of the machine or container in which a process number is unique."""
    try:
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        processes = ""
    return hashlib.sha256(f"{platform.node()} {processes}".encode()).hexdigest()[:8]


def _start(process: int) -> int | None:
    """When a process started, in clock ticks since the start of the machine; None if there is no such process."""
    try:
        line = (_PROCESSES / str(process) / "stat").read_text(encoding="utf-8", errors="replace")
        return int(line.rpartition(")")[2].split()[19])  # field 22; the name of the program may contain blanks
    except (OSError, IndexError, ValueError):
        return None


def _is_remnant(path: Path) -> bool:
    marked = _MARKED.fullmatch(path.name)
    if marked is None or not belongs_to_user(path):
        return False
    machine, process, start = marked[1], int(marked[2]), int(marked[3])
    if machine == _machine() and _start(os.getpid()) is not None:
        return _start(process) != start
    try:
        return time.time() - path.lstat().st_mtime > FORGOTTEN
    except OSError:
        return False
