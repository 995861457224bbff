"""The textbook's formulas as witnesses: printed and corrected, each against automatic derivatives; laws of accuracy.

partials        the 18 partials and the matrix, printed and corrected
crosscheck      each of them against autodiff and the complex step
accuracy_laws   accumulation of errors along a strip, distance between control
"""

from jaxbundle.textbook import accuracy_laws
from jaxbundle.textbook.crosscheck import CrossCheck, crosscheck, orthonormality_defect
from jaxbundle.textbook.partials import printed_matrix, printed_partials, regular_partials

__all__ = [
    "CrossCheck",
    "accuracy_laws",
    "crosscheck",
    "orthonormality_defect",
    "printed_matrix",
    "printed_partials",
    "regular_partials",
]
