"""Weight functions of robust adjustments: `jb.adjust(block, robust=jb.robust.Huber())`."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
