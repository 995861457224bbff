"""Table of all foreign formats: name, recognition by content, reader and writer."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.io.formats.bingo import is_bingo, read_bingo, write_bingo
from jaxbundle.io.formats.blocks_exchange import is_blocks_exchange, read_blocks_exchange, write_blocks_exchange
from jaxbundle.io.formats.bundler import is_bundler, read_bundler, write_bundler
from jaxbundle.io.formats.colmap import is_colmap, read_colmap
from jaxbundle.io.formats.colmap_writer import write_colmap
from jaxbundle.io.formats.exterior import write_exterior
from jaxbundle.io.formats.foreign_block import DEFAULT, ForeignBlock, ReadOptions
from jaxbundle.io.formats.inpho import is_inpho, read_inpho
from jaxbundle.io.formats.inpho_writer import write_inpho
from jaxbundle.io.formats.metashape import is_metashape, read_metashape
from jaxbundle.io.formats.metashape_writer import write_metashape
from jaxbundle.io.formats.micmac import is_micmac, read_micmac, write_micmac
from jaxbundle.io.formats.nvm import is_nvm, read_nvm, write_nvm
from jaxbundle.io.formats.opensfm import is_opensfm, read_opensfm
from jaxbundle.io.formats.opensfm_writer import write_opensfm
from jaxbundle.io.formats.opf import is_opf, read_opf
from jaxbundle.io.formats.opf_writer import write_opf
from jaxbundle.io.formats.orima import is_orima, read_orima
from jaxbundle.io.formats.patb import is_patb, read_patb, write_patb
from jaxbundle.io.formats.pix4d import is_pix4d, read_pix4d
from jaxbundle.io.formats.pix4d_writer import write_pix4d

Reader = Callable[[Path, ReadOptions], ForeignBlock]
Writer = Callable[[Block, Path], list[str]]


class Format(NamedTuple):
    """A format: its name on the command line and in words, its test of a path, its reader and writer."""

    name: str
    words: str
    recognised: Callable[[Path], bool] | None
    read: Reader | None
    write: Writer | None
    suffix: str = ""
    """Suffix of the file that `convert` writes in this format; "" for a folder. A suffix with two points
    does not follow from the name of the output."""


def _colmap_text(block: Block, path: Path) -> list[str]:
    return write_colmap(block, path, text=True)


_FORMATS = (
    Format("colmap", "a COLMAP model", is_colmap, read_colmap, write_colmap),
    Format("colmap-text", "a COLMAP model as text", None, read_colmap, _colmap_text),
    Format("opensfm", "an OpenSfM or OpenDroneMap project", is_opensfm, read_opensfm, write_opensfm),
    Format("metashape", "a Metashape project", is_metashape, read_metashape, write_metashape, ".markers.xml"),
    Format(
        "blocksexchange",
        "a BlocksExchange file",
        is_blocks_exchange,
        read_blocks_exchange,
        write_blocks_exchange,
        ".xml",
    ),
    Format("bundler", "a Bundler file", is_bundler, read_bundler, write_bundler, ".out"),
    Format("nvm", "an NVM file", is_nvm, read_nvm, write_nvm, ".nvm"),
    Format("bingo", "a BINGO project", is_bingo, read_bingo, write_bingo),
    Format("patb", "a PATB project", is_patb, read_patb, write_patb),
    Format("inpho", "an Inpho project", is_inpho, read_inpho, write_inpho, ".prj"),
    Format("micmac", "a MicMac project", is_micmac, read_micmac, write_micmac),
    Format("opf", "an OPF project", is_opf, read_opf, write_opf),
    Format("pix4d", "a params folder of Pix4D", is_pix4d, read_pix4d, write_pix4d),
    Format("orima", "measurements of ORIMA", is_orima, read_orima, None),
    Format("exterior", "a table of exterior elements", None, None, write_exterior, ".csv"),
)
FORMATS: dict[str, Format] = {form.name: form for form in _FORMATS}
READ = tuple(form.name for form in _FORMATS if form.read)
WRITTEN = tuple(form.name for form in _FORMATS if form.write)


def recognised(path: Path) -> list[Format]:
    """The formats that match the content of a path."""
    return [form for form in _FORMATS if form.recognised is not None and form.recognised(path)]


def read_format(path: Path, name: str, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads a path in a format, to a foreign block.

    Raises: ValueError for a format that is not read; BlockError with all problems.
    """
    form = FORMATS.get(name)
    if form is None or form.read is None:
        raise ValueError(f"format '{name}' is not read; known: {', '.join(READ)}")
    return form.read(path, options)


def write_format(block: Block, path: str | Path, name: str) -> tuple[str, ...]:
    """Writes a block in the format of another program, by its name in `FORMATS`.

    Returns: sentences about contents of the block that the format cannot represent.

    Raises: ValueError for an unknown name.

    Example:
        >>> jb.io.write_format(result.block, "out", "colmap")
        ('4 rows of control', '1 check point')
    """
    require_a(Block, block, "io.write_format")
    form = FORMATS.get(name)
    if form is None or form.write is None:
        raise ValueError(f"format '{name}' is not written; known: {', '.join(WRITTEN)}")
    return tuple(form.write(block, Path(path)))
