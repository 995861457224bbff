"""Replacing a folder of earlier results by a new one as a whole.

The new folder is written in a hidden folder next to the target, and then both exchange their names in one step of the
file system. Files that do not belong to the results are moved from the old folder to the new one. If a folder cannot be
renamed (a mount point, the current folder, a folder of another user), its files are replaced one by one, report.json
last; if that is interrupted, the next run completes it. `tidy` repairs the state after any interruption; it is called
at the beginning and at the end of each replacement.

    hidden folder    files.json   names of the result files, and of the target
                     new/         the new results; after the exchange, the old ones
                     old/         the old results, where the file system cannot exchange two names
                     ready        marks that the files of `new` are moved one by one
"""

import ctypes
import errno
import json
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from jaxbundle.numerics.whole_files import belongs_to_user, marked_name, remnants, sync_file, sync_folder

TEXT, DATA, PAGE = "report.txt", "report.json", "report.html"
ANOTHER = "give another folder for the results (--out)"
_RECORD, _NEW, _OLD, _READY = "files.json", "new", "old", "ready"
_AT_FOLDER, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux's renameat2
_TRIAL = bytes(4096)  # a block of most file systems
_REASONS = {
    errno.EACCES: "no permission to write there",
    errno.EPERM: "no permission to write there",
    errno.EROFS: "the file system is read-only",
    errno.ENOSPC: "no space is left there",
    errno.EDQUOT: "your quota of space is used up",
    errno.ENAMETOOLONG: "the name is too long",
}


class Record(NamedTuple):
    """Purpose of a hidden folder: target and files."""

    target: str  # name of the folder next to the hidden one; "" for the folder that contains the hidden one
    names: list[str]  # files of the new results
    files: list[str]  # these and the files of the earlier results


def require_writable(target: Path, names: Iterable[str], size: int) -> None:
    """Checks that results can be written to a folder: `names` of their files, about `size` bytes.

    Raises: OSError in one sentence with the path and the cure, where they cannot be written, or would replace files
    that no adjustment wrote.
    """
    place = _place_of(target)
    try:
        tidy(place)
        earlier = earlier_files(place)
        foreign = [name for name in names if name not in earlier and os.path.lexists(place / name)]
        home = _existing(_home(place, {*names, *earlier}))
    except OSError as error:
        raise _not_writable(target, error) from error
    if foreign:
        raise FileExistsError(f"{target} contains {', '.join(foreign)}, which no adjustment wrote; {ANOTHER}")
    if not home.is_dir():
        raise NotADirectoryError(f"{home} is a file, so the folder {target} cannot be created below it; {ANOTHER}")
    trial = home / marked_name()
    try:
        try:
            trial.write_bytes(_TRIAL)
            sync_file(trial)
        finally:
            trial.unlink(missing_ok=True)
        free = shutil.disk_usage(home).free
    except OSError as error:
        raise _not_writable(target, error) from error
    if free < size:
        raise OSError(
            f"the results need about {_megabytes(size)}, but {_megabytes(free)} are free in {home};"
            f" {ANOTHER}, or free some space"
        )


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.0f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"


def _not_writable(target: Path, error: OSError) -> OSError:
    reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
    return type(error)(f"results cannot be written to {target}: {reason}; {ANOTHER}")


def _place_of(target: Path) -> Path:
    """The target of the path, if it is a link.

    Raises: FileExistsError if it is not a folder.
    """
    try:
        if target.is_symlink() and not target.exists():
            raise FileExistsError(f"{target} is a link to {os.readlink(target)}, which does not exist; {ANOTHER}")
        if target.exists() and not target.is_dir():
            raise FileExistsError(f"{target} is a file; give a folder for the results")
        return target.resolve()
    except FileExistsError:
        raise
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise OSError(f"results cannot be written to {target}: {error}; {ANOTHER}") from error


def _existing(place: Path) -> Path:
    """The folder, or the nearest existing folder above it."""
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    return place


def earlier_files(folder: Path) -> set[str]:
    """Files of the folder that an earlier adjustment wrote, according to its report.json."""
    try:
        files = json.loads((folder / DATA).read_text(encoding="utf-8"))["files"]
        named = {
            name for name in files if Path(name).name == name and (name.endswith(".csv") or name in (DATA, TEXT, PAGE))
        }
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    return {name for name in named if stat.S_ISREG(_mode(folder / name))}


def _mode(path: Path) -> int:
    try:
        return path.lstat().st_mode
    except OSError:
        return 0


@contextmanager
def replaced(target: Path, names: Iterable[str]) -> Iterator[Path]:
    """Context of a new folder for results, which replaces the target when all results are written.

    Raises: OSError where they cannot be written.
    """
    place, names = _place_of(target), list(names)
    tidy(place)
    files = {*names, *earlier_files(place)}
    home = _home(place, files)
    home.mkdir(parents=True, exist_ok=True)
    hidden = home / marked_name()
    hidden.mkdir(mode=0o700)
    try:
        record = Record("" if home == place else place.name, names, sorted(files))
        (hidden / _RECORD).write_text(json.dumps(record._asdict()), encoding="utf-8")
        new = hidden / _NEW
        new.mkdir()  # a subfolder, as only this gets the permissions of a usual folder
        yield new
        for path in (*new.iterdir(), hidden / _RECORD):
            sync_file(path)
        sync_folder(new)
        if home == place:
            (hidden / _READY).touch()
            _move_files(hidden, place, record)
        else:
            _take_place(new, place)
        sync_folder(home)
    finally:
        _finish(hidden)


def tidy(place: Path) -> None:
    """Completes or removes what killed processes left in a folder of results or next to it."""
    for hidden in (*remnants(place), *remnants(place.parent)):
        if hidden.is_dir():
            _finish(hidden)
        else:
            hidden.unlink(missing_ok=True)


def _home(place: Path, files: set[str]) -> Path:
    """Parent of the hidden folder: next to a folder that is new or can be renamed, otherwise inside it."""
    return place.parent if not place.is_dir() or _can_be_renamed(place, files) else place


def _can_be_renamed(place: Path, files: set[str]) -> bool:
    """Whether a folder can exchange its name with another one, and its other files can be moved."""
    if (
        _is_current(place)
        or os.path.ismount(place)
        or not belongs_to_user(place)
        or not os.access(place.parent, os.W_OK | os.X_OK)
    ):
        return False
    with os.scandir(place) as entries:
        others = [entry for entry in entries if entry.name not in files]
    return all(os.access(entry.path, os.W_OK) for entry in others if entry.is_dir(follow_symlinks=False))


def _is_current(place: Path) -> bool:
    """Whether it is the current folder: after an exchange the user's shell would be in a deleted folder."""
    try:
        return os.path.samefile(place, os.curdir)
    except OSError:
        return False


def _take_place(new: Path, place: Path) -> None:
    """Puts the new folder at the name of the old one; an old folder is afterwards `new` or, next to it, `old`."""
    if place.is_dir():
        shutil.copymode(place, new)
        _exchange(new, place)
        return
    try:
        os.rename(new, place)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        _exchange(new, place)  # another process was faster


def _exchange(new: Path, place: Path) -> None:
    """Exchanges two folders, in one step where the system can."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    if rename is None or rename(_AT_FOLDER, os.fsencode(new), _AT_FOLDER, os.fsencode(place), _EXCHANGE):
        os.rename(place, new.with_name(_OLD))
        os.rename(new, place)


def _move_files(hidden: Path, place: Path, record: Record) -> None:
    """Replaces the files of earlier results one by one; it can be repeated after an interruption.

    report.json is removed first and written last: where it exists, all other files belong to it.
    """
    for name in (DATA, TEXT, *(name for name in record.files if name not in record.names)):
        if name not in record.names or (hidden / _NEW / name).exists():
            (place / name).unlink(missing_ok=True)
    for name in sorted(record.names, key=lambda name: name == DATA):
        if (hidden / _NEW / name).exists():
            os.replace(hidden / _NEW / name, place / name)
    sync_folder(place)


def _finish(hidden: Path) -> None:
    """Completes or removes the rest of a replacement; files of others are not removed."""
    try:
        record = Record(**json.loads((hidden / _RECORD).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        shutil.rmtree(hidden, ignore_errors=True)  # the record is written before anything is replaced
        return
    place = hidden.parent / record.target
    if (hidden / _READY).exists():
        _move_files(hidden, place, record)
    if (hidden / _OLD).is_dir() and not place.exists():
        os.rename(hidden / _OLD, place)
    for part in (hidden / _NEW, hidden / _OLD):
        files = {*record.files, *earlier_files(part)}  # of another process that was faster
        for name in sorted(os.listdir(part)) if part.is_dir() else ():
            if name not in files:
                place.mkdir(exist_ok=True)
                os.rename(part / name, _free(place / name))
    shutil.rmtree(hidden, ignore_errors=True)


def _free(path: Path) -> Path:
    """The path, with a number appended to its name if it exists already."""
    number, found = 1, path
    while os.path.lexists(found):
        number += 1
        found = path.with_name(f"{path.name}-{number}")
    return found
