"""The table of all camera models by name."""

from jaxbundle.camera.additional_parameters import EBNER, GRUEN
from jaxbundle.camera.brown import BROWN, BROWN_AFFINE_LAST, BROWN_SCALE_FIRST, DISTORTION_FREE
from jaxbundle.camera.corrections import with_corrections
from jaxbundle.camera.forward import AICON, BAL, BROWN_FORWARD, METASHAPE
from jaxbundle.camera.lenses import DIVISION, EUCM, FISHEYE, FISHEYE_624, FOV, RATIONAL
from jaxbundle.camera.model import CameraModel

_MODELS = (
    DISTORTION_FREE,
    BROWN,
    BROWN_AFFINE_LAST,
    BROWN_SCALE_FIRST,
    BROWN_FORWARD,
    AICON,
    METASHAPE,
    BAL,
    EBNER,
    GRUEN,
    RATIONAL,
    FISHEYE,
    FISHEYE_624,
    FOV,
    DIVISION,
    EUCM,
)
CAMERA_MODELS = {model.name: model for model in _MODELS}
"""All camera models by name.

Example:
    >>> jb.cameras.CAMERA_MODELS["brown"].elements[:3]
    ('principal_distance', 'x0', 'y0')
"""


def named_model(model: CameraModel) -> CameraModel | None:
    """The equal model of `CAMERA_MODELS`, also for a model with corrections; None for any other."""
    return next((own for own in _MODELS if model is own or model is with_corrections(own)), None)
