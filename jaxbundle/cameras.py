"""Cameras: models of the interior orientation, corrections of rays, inner orientation of scanned photographs.

models          CAMERA_MODELS by name; CameraModel makes a new one
equation        collinearity, the image equation of one ray
corrections     with_corrections; refraction_coefficient, curvature_coefficient
fiducials       inner_orientation
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
