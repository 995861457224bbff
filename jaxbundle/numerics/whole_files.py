"""Files that are written beside their place and moved there when they are whole.

What is being written bears the mark of its process in its name, `.jaxbundle-MACHINE-PID-START-RANDOM`. So the remnant
of a process that was killed is told from what another process is writing at this moment.
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
FORGOTTEN = 86_400.0  # seconds: a process on another machine cannot be looked up; no report takes a day to write


def marked_name() -> str:
    """A new hidden name that tells which process it belongs to."""
    return f"{PREFIX}{_machine()}-{os.getpid()}-{_start(os.getpid()) or 0}-{secrets.token_hex(4)}"


def remnants(folder: Path) -> list[Path]:
    """Files and folders of this user that a process which is no more has left in a folder."""
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
    """Writes a file beside its place, brings it to the disk and moves it to its place; removes it if that fails.

    `mode`: its permissions, less what the user's mask forbids. Raises: OSError where the place cannot be written.
    """
    for remnant in remnants(path.parent):
        if not remnant.is_dir():
            remnant.unlink(missing_ok=True)
    beside = path.parent / marked_name()
    try:
        # a new file: no link that another user has put there is followed
        with open(beside, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_file(path: Path) -> None:
    """Brings a file to the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path: Path) -> None:
    """Brings the names in a folder to the disk, where the file system knows how."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return  # Windows opens no folders
    try:
        os.fsync(descriptor)
    except OSError:
        pass  # some network file systems sync no folders
    finally:
        os.close(descriptor)


@cache
def _machine() -> str:
    """Mark of the machine or container, in which a process number means one process."""
    try:
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        processes = ""
    return hashlib.sha256(f"{platform.node()} {processes}".encode()).hexdigest()[:8]


def _start(process: int) -> int | None:
    """When a process started, in clock ticks since the machine did; None where there is no such process."""
    try:
        line = (_PROCESSES / str(process) / "stat").read_text(encoding="utf-8", errors="replace")
        return int(line.rpartition(")")[2].split()[19])  # field 22; the name of the program may hold blanks
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
