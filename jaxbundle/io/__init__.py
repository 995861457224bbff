"""Blocks in files: `read_x(path) -> Block` and `write_x(block, path)` for every format; `read` tells them apart."""

from jaxbundle.io.bal import read_bal, write_bal
from jaxbundle.io.block_folder import read_block_folder
from jaxbundle.io.block_folder_writer import write_block_folder
from jaxbundle.io.flight_toml import read_flight
from jaxbundle.io.read import read

__all__ = ["read", "read_bal", "read_block_folder", "read_flight", "write_bal", "write_block_folder"]
