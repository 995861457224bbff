"""Reading a block of any known form, told apart by content."""

from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_findings
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.diagnosis.before import prepared
from jaxbundle.io.bal import HEAD, is_bal, read_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_toml import FILE
from jaxbundle.io.foreign import known_file, known_folder
from jaxbundle.io.text import UnreadableError, file_bytes

KNOWN = f"give a folder with {FILE} or a BAL text file"


def read(path: str | Path, *, check_start: bool = True) -> Block:
    """The block in a block folder, also named by its block.toml, or in a BAL file.

    `check_start`: judge its numbers, and replace absurd approximate values where that is beyond doubt; what was found
    stands in `structure.findings`.

    Raises: BlockError with all that is wrong, or where the path is none of them.
    """
    path = Path(path)
    if _is_folder(path):
        return read_block_folder(_folder_of(path), check_start=check_start)
    block = read_bal(path)
    return with_findings(*prepared(block)) if check_start else block


def _is_folder(path: Path) -> bool:
    """Whether a path means a block folder; else it is a BAL file.

    Raises: BlockError where it is neither.
    """
    try:
        if path.is_dir():
            if not (path / FILE).is_file():
                raise _no_block_toml(path)
            return True
        if path.name == FILE and path.is_file():
            return True
        head = file_bytes(path, HEAD)
    except UnreadableError as error:
        what = "does not exist" if error.what == "is missing" else error.what
        raise BlockError([Problem(f"{shown(str(path), 300)} {what}", KNOWN)]) from error
    except OSError as error:
        raise BlockError([Problem(f"{shown(str(path), 300)} cannot be read: {error.strerror}", KNOWN)]) from error
    if is_bal(head):
        return False
    known, cure = known_file(path, head), KNOWN
    if (path.parent / FILE).is_file():
        known, cure = f"is a file of the block folder {path.parent}", "give the folder itself"
    elif known:
        known = f"{known}, which is not read"
    raise BlockError([Problem(f"{path} {known or 'is in no known form'}", cure)])


def _folder_of(path: Path) -> Path:
    return path if path.is_dir() else path.parent


def _no_block_toml(folder: Path) -> BlockError:
    known = known_folder(folder)
    if known:
        return BlockError([Problem(f"{folder} is {known}; it is not read yet", KNOWN)])
    if (folder / "rays.csv").is_file():
        cure = f"write {FILE}: units, rotation system, cameras, sigma and the names of the tables"
        return BlockError([Problem(f"folder {folder} has tables and no {FILE}", cure)])
    below = sorted(path.parent.name for path in folder.glob(f"*/{FILE}"))
    cure = f"give one of its folders: {', '.join(below[:10])}" if below else KNOWN
    return BlockError([Problem(f"folder {folder} has no {FILE}", cure)])
