"""Blocks: their parts, their datum, and what can be wrong with them before an adjustment.

parts       Block, made of Structure (names and incidences) and of values: Camera, InteriorOrientation,
            ExteriorOrientation, Rays, CheckPoints, Parameter
datum       Datum, with_datum, datum_defect; with_interior_held fixes the interior orientation
checks      validate (BlockError with all problems), plausibility, prepared; their Finding has a Kind,
            a Severity and a Subject
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
