"""Types of what adjustments return: for annotations and comparisons, no user makes them."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
