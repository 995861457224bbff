"""The textbook's formulas as witnesses: printed and corrected, each against automatic derivatives."""

from jaxbundle.textbook.crosscheck import CrossCheck, crosscheck, orthonormality_defect
from jaxbundle.textbook.partials import printed_matrix, printed_partials, regular_partials

__all__ = [
    "CrossCheck",
    "crosscheck",
    "orthonormality_defect",
    "printed_matrix",
    "printed_partials",
    "regular_partials",
]
