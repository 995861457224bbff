"""Observations that are not image points: their kinds, and groups of them in a block.

kinds       CONTROL, STATIONS, GNSS_STATIONS, ATTITUDES, PARAMETERS, LINES, PLANES, DISTANCES; geodetic_kind for
            other measurements between points and images, interior_priors for interior elements
groups      observation_group makes an ObservationGroup of observations of one kind
your kinds  ObservationKind(name, labels, kinds of members, residual)
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
