"""Types of the results of adjustments, for annotations and comparisons; users do not create them."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
