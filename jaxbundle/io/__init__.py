"""Blocks in files: `read_x(path) -> Block` and `write_x(block, path)` for every format; `read` tells them apart.

The formats of other programs are in `formats`; `write_format` writes them by name. `export` writes what maps, clouds
and drawings show of results, by the modules of `results`.
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
