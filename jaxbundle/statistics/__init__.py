"""What the residuals tell: precision, reliability, variance components, the influence of control's errors."""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
