"""Blocks in files: `read_x(path) -> Block` and `write_x(block, path)` for each format; `read` recognises the format.

The formats of other programs are in `formats`; `write_format` writes them by name. `export` writes results as maps,
point clouds and drawings; the modules of `results` implement it.
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
