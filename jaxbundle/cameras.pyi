from jaxbundle.camera.camera_models import CAMERA_MODELS as CAMERA_MODELS
from jaxbundle.camera.collinearity import collinearity as collinearity
from jaxbundle.camera.corrections import (
    curvature_coefficient as curvature_coefficient,
    refraction_coefficient as refraction_coefficient,
    with_corrections as with_corrections,
)
from jaxbundle.camera.fiducials import (
    FiducialError as FiducialError,
    InnerOrientation as InnerOrientation,
    inner_orientation as inner_orientation,
)
from jaxbundle.camera.model import CameraModel as CameraModel
