"""Stopping rules of an adjustment: `jb.adjust(block, stop=jb.stopping.AngleRule(1e-6))`."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
