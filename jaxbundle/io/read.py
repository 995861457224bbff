"""Reading a block of any known form, told apart by content."""

from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_findings
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.diagnosis.before import prepared
from jaxbundle.io.bal import HEAD, is_bal, read_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_toml import FILE
from jaxbundle.io.foreign import DATABASE, DATABASE_CURE, is_database, known_file, known_folder
from jaxbundle.io.formats.registry import FORMATS, READ, Format, recognised
from jaxbundle.io.formats.sources import Sources, read_sources
from jaxbundle.io.text import UnreadableError, file_bytes

KNOWN = f"give a folder with {FILE}, a BAL text file, or one of: {', '.join(READ)}"


def read(path: str | Path, *, check_start: bool = True, sources: Sources | None = None) -> Block:
    """The block in a block folder, also named by its block.toml, in a BAL file, or in a format of another program.

    `check_start`: judge its numbers, and replace absurd approximate values where that is beyond doubt; what was found
    stands in `structure.findings`. `sources`: of a block of another program, its format and the tables of control and
    stations beside it.

    Raises: BlockError with all that is wrong, or where the path is none of them.

    Example:

        >>> block = jb.read("colmap/sparse/0", sources=jb.Sources(control=Path("gcp_list.txt")))
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
    """Raises BlockError where tables are given beside a form that has its own."""
    if sources.control or sources.stations:
        what = f"{shown(str(path))} is a block folder or a BAL file; tables beside it are not read"
        raise BlockError([Problem(what, "put control.csv and stations.csv into a block folder (jaxbundle convert)")])


def _format(path: Path, sources: Sources) -> Format | None:
    """The foreign format of a path; None for a block folder or a BAL file.

    Raises: BlockError where it is neither, or several.
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
        raise BlockError([Problem(what, f"say which one with --format, one of: {names}")])
    raise _unknown_folder(path) if path.is_dir() else _unknown_file(path, head)


def _recognised(path: Path) -> list[Format]:
    """The formats of a path that is named in a message only; none where it cannot be looked at."""
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
    return BlockError([Problem(f"{path} {known or 'is in no known form'}", cure)])


def _unknown_folder(folder: Path) -> BlockError:
    known = known_folder(folder)
    if known:
        return BlockError([Problem(f"{folder} is {known}, which is not read, or not complete", KNOWN)])
    if (folder / "rays.csv").is_file():
        cure = f"write {FILE}: units, rotation system, cameras, sigma and the names of the tables"
        return BlockError([Problem(f"folder {folder} has tables and no {FILE}", cure)])
    below = sorted(path.parent.name for path in folder.glob(f"*/{FILE}"))
    below = below or sorted(path.name for path in folder.glob("*") if path.is_dir() and _recognised(path))
    cure = f"give one of its folders: {', '.join(below[:10])}" if below else KNOWN
    return BlockError([Problem(f"folder {folder} has no {FILE}", cure)])
