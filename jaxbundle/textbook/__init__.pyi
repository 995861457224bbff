from jaxbundle.textbook import accuracy_laws as accuracy_laws
from jaxbundle.textbook.cross_checks import (
    CrossCheck as CrossCheck,
    crosscheck as crosscheck,
    orthonormality_defect as orthonormality_defect,
)
from jaxbundle.textbook.partials import (
    printed_matrix as printed_matrix,
    printed_partials as printed_partials,
    regular_partials as regular_partials,
)
