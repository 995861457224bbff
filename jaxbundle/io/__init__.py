"""Blocks in files: `read_x(path) -> Block` and `write_x(block, path)` for each format; `read` recognises the format.

The formats of other programs are in `formats`; `write_format` writes them by name. `export` writes results as maps,
point clouds and drawings; the modules of `results` implement it.
"""

from jaxbundle.io.bal import read_bal, write_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_folder_writer import write_block_folder
from jaxbundle.io.flight_toml import read_flight
from jaxbundle.io.formats.registry import write_format
from jaxbundle.io.formats.sources import Sources
from jaxbundle.io.read import read
from jaxbundle.io.results.export import export

__all__ = [
    "Sources",
    "export",
    "read",
    "read_bal",
    "read_block_folder",
    "read_flight",
    "write_bal",
    "write_block_folder",
    "write_format",
]
