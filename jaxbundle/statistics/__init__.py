"""Statistics of an adjustment: precision, reliability, tests, variance components, influence of errors of control."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
