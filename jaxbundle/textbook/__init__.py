"""Formulas of Text 000, printed and corrected, compared with automatic derivatives; laws of accuracy.

partials        the 18 partials and the matrix, printed and corrected
cross_checks    each of them against autodiff and the complex step
accuracy_laws   accumulation of errors along a strip, distance between control
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
