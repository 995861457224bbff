"""Reading a block of any known form, told apart by content."""

from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.bal import HEAD, is_bal, read_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_toml import FILE

KNOWN = f"give a folder with {FILE} or a BAL text file"


def read(path: str | Path) -> Block:
    """The block in a block folder or a BAL file.

    Raises: BlockError with all that is wrong, or where the path is none of them.
    """
    path = Path(path)
    if not path.exists():
        raise BlockError([Problem(f"{path} does not exist", KNOWN)])
    if path.is_dir():
        if not (path / FILE).is_file():
            raise BlockError([Problem(f"folder {path} has no {FILE}", KNOWN)])
        return read_block_folder(path)
    with path.open("rb") as file:
        head = file.read(HEAD)
    if not is_bal(head):
        raise BlockError([Problem(f"{path} is in no known form", KNOWN)])
    return read_bal(path)
