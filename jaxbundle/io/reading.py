"""Reading a block in any known format; the format is recognised by the content."""

from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_findings
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.diagnosis.before import prepared
from jaxbundle.io.bal import HEAD, is_bal, read_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_toml import FILE
from jaxbundle.io.foreign import DATABASE, DATABASE_CURE, is_database, known_file, known_folder
from jaxbundle.io.formats.format_table import FORMATS, READ, Format, recognised
from jaxbundle.io.formats.side_tables import Sources, read_sources
from jaxbundle.io.text_files import UnreadableError, file_bytes

KNOWN = f"give a folder with {FILE}, a BAL text file, or one of: {', '.join(READ)}"


def read(path: str | Path, *, check_start: bool = True, sources: Sources | None = None) -> Block:
    """Reads a block from a block folder or its block.toml, from a BAL file, or from a format of another program.

    `check_start`: check the numbers, and replace absurd approximate values where that is beyond doubt; the findings
    are in `structure.findings`. `sources`: for a block of another program, its format and additional tables of
    control and stations.

    Raises: BlockError with all problems, or where the path has no known format.

    Example:
        >>> block = jb.read("quarry")
        >>> _ = jb.io.write_format(block, "project", "colmap")
        >>> len(jb.read("project", sources=jb.io.Sources(format="colmap")).images)
        4
    """
    path, sources = Path(path), sources or Sources()
    form = _format(path, sources)
    if form is None and (path.is_dir() or path.name == FILE):
        _require_alone(path, sources)
        return read_block_folder(path if path.is_dir() else path.parent, check_start=check_start)
    if form is None:
        _require_alone(path, sources)
        block = read_bal(path)
    else:
        block = read_sources(path, form, sources)
    return with_findings(*prepared(block)) if check_start else block


def _require_alone(path: Path, sources: Sources) -> None:
    """Raises BlockError where additional tables are given for a format with its own tables."""
    if sources.control or sources.stations:
        what = f"{shown(str(path))} is a block folder or a BAL file; additional tables are not read"
        raise BlockError([Problem(what, "put control.csv and stations.csv into a block folder (jaxbundle convert)")])


def _format(path: Path, sources: Sources) -> Format | None:
    """The foreign format of a path; None for a block folder or a BAL file.

    Raises: BlockError where it has no known format, or several.
    """
    if sources.format:
        form = FORMATS.get(sources.format)
        if form is None or form.read is None:
            raise BlockError([Problem(f"format '{shown(sources.format)}' is unknown", f"known: {', '.join(READ)}")])
        if not path.exists():
            raise BlockError([Problem(f"{shown(str(path), 300)} does not exist", KNOWN)])
        return form
    try:
        if (path / FILE).is_file() or (path.name == FILE and path.is_file()):
            return None
        head = b"" if path.is_dir() else file_bytes(path, HEAD)
        forms = [] if is_bal(head) else recognised(path)
    except UnreadableError as error:
        what = "does not exist" if error.what == "is missing" else error.what
        raise BlockError([Problem(f"{shown(str(path), 300)} {what}", KNOWN)]) from error
    except OSError as error:
        raise BlockError([Problem(f"{shown(str(path), 300)} cannot be read: {error.strerror}", KNOWN)]) from error
    if is_bal(head):
        return None
    if len(forms) == 1:
        return forms[0]
    if forms:
        names = ", ".join(form.name for form in forms)
        what = f"{path} is {' and '.join(form.words for form in forms)}"
        raise BlockError([Problem(what, f"choose one with --format, one of: {names}")])
    raise _unknown_folder(path) if path.is_dir() else _unknown_file(path, head)


def _recognised(path: Path) -> list[Format]:
    """The formats of a path for use in a message; none where it cannot be read."""
    try:
        return recognised(path)
    except OSError:
        return []


def _unknown_file(path: Path, head: bytes) -> BlockError:
    known, cure = known_file(path, head), KNOWN
    if (path.parent / FILE).is_file():
        known, cure = f"is a file of the block folder {path.parent}", "give the folder itself"
    elif (form := next(iter(_recognised(path.parent)), None)) is not None:
        known, cure = f"is a file of {form.words}", f"give the folder {path.parent}"
    elif is_database(path):
        known, cure = DATABASE, DATABASE_CURE
    elif known:
        known = f"{known}, which is not read"
    return BlockError([Problem(f"{path} {known or 'has an unknown format'}", cure)])


def _unknown_folder(folder: Path) -> BlockError:
    known = known_folder(folder)
    if known:
        return BlockError([Problem(f"{folder} is {known}, which is not read, or not complete", KNOWN)])
    if (folder / "rays.csv").is_file():
        cure = f"write {FILE}: units, rotation system, cameras, sigma and the names of the tables"
        return BlockError([Problem(f"folder {folder} has tables but no {FILE}", cure)])
    below = sorted(path.parent.name for path in folder.glob(f"*/{FILE}"))
    below = below or sorted(path.name for path in folder.glob("*") if path.is_dir() and _recognised(path))
    cure = f"give one of its folders: {', '.join(below[:10])}" if below else KNOWN
    return BlockError([Problem(f"folder {folder} has no {FILE}", cure)])
