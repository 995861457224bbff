"""Conversion between the camera models of COLMAP and of this package: exact in both directions, or refused.

    f = fy, b1 = fx - fy,  P1 = p2, P2 = p1,  principal point unchanged       (numbers of a model as COLMAP counts them)

Source: the camera models of COLMAP 4.2, src/colmap/sensor/models.h.
"""

from typing import NamedTuple

from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.camera.lenses import DIVISION, EUCM, FISHEYE, FISHEYE_624, FOV, RATIONAL
from jaxbundle.camera.model import CameraModel
from jaxbundle.io.formats.foreign_block import ForeignCamera, element


class ColmapModel(NamedTuple):
    """A model of COLMAP: its number, name, parameters with the names of elements here, and the equal model here."""

    number: int
    name: str
    parameters: tuple[str, ...]
    model: CameraModel | None


_ONE, _TWO = ("f", "x0", "y0"), ("fx", "fy", "x0", "y0")
_DECENTRING = ("P2", "P1")
MODELS = (
    ColmapModel(0, "SIMPLE_PINHOLE", _ONE, METASHAPE),
    ColmapModel(1, "PINHOLE", _TWO, METASHAPE),
    ColmapModel(2, "SIMPLE_RADIAL", (*_ONE, "K1"), METASHAPE),
    ColmapModel(3, "RADIAL", (*_ONE, "K1", "K2"), METASHAPE),
    ColmapModel(4, "OPENCV", (*_TWO, "K1", "K2", *_DECENTRING), METASHAPE),
    ColmapModel(5, "OPENCV_FISHEYE", (*_TWO, "K1", "K2", "K3", "K4"), FISHEYE),
    ColmapModel(6, "FULL_OPENCV", (*_TWO, "K1", "K2", *_DECENTRING, "K3", "K4", "K5", "K6"), RATIONAL),
    ColmapModel(7, "FOV", (*_TWO, "omega"), FOV),
    ColmapModel(8, "SIMPLE_RADIAL_FISHEYE", (*_ONE, "K1"), FISHEYE),
    ColmapModel(9, "RADIAL_FISHEYE", (*_ONE, "K1", "K2"), FISHEYE),
    ColmapModel(10, "THIN_PRISM_FISHEYE", (*_TWO, "K1", "K2", *_DECENTRING, "K3", "K4", "S1", "S2"), FISHEYE),
    ColmapModel(
        11,
        "RAD_TAN_THIN_PRISM_FISHEYE",
        (*_TWO, "K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2", "S1", "S2", "S3", "S4"),
        FISHEYE_624,
    ),
    ColmapModel(12, "SIMPLE_DIVISION", (*_ONE, "k"), DIVISION),
    ColmapModel(13, "DIVISION", (*_TWO, "k"), DIVISION),
    ColmapModel(14, "SIMPLE_FISHEYE", _ONE, FISHEYE),
    ColmapModel(15, "FISHEYE", _TWO, FISHEYE),
    ColmapModel(16, "EUCM", (*_TWO, "alpha", "beta"), EUCM),
    ColmapModel(17, "EQUIRECTANGULAR", ("w", "h"), None),
)
BY_NUMBER = {model.number: model for model in MODELS}
BY_NAME = {model.name: model for model in MODELS}
READ = ", ".join(model.name for model in MODELS if model.model)
# models of one kind of lens, with few parameters first: the first one that represents a camera is written
_WRITTEN = sorted((model for model in MODELS if model.model), key=lambda model: len(model.parameters))


def camera_from_colmap(
    name: str, model: ColmapModel, width: int, height: int, parameters: list[float]
) -> ForeignCamera:
    """A camera of a supported model. As in COLMAP, the principal point is not estimated.

    Example: SIMPLE_RADIAL with (2971.71, 1416, 1064, -0.164) is `metashape` with principal_distance 2971.71.
    """
    assert model.model is not None
    given = dict(zip(model.parameters, parameters, strict=True))
    elements = {key: value for key, value in given.items() if key not in ("f", "fx", "fy")}
    elements["principal_distance"] = given.get("f", given.get("fy", 0.0))
    estimate = ["principal_distance"]
    if "fx" in given:
        elements["b1"] = given["fx"] - given["fy"]
        estimate.append("b1")
    estimate += [key for key in elements if key not in ("principal_distance", "x0", "y0", "b1")]
    return ForeignCamera(name, model.model, elements, tuple(estimate), "px", width, height)


def colmap_from_camera(camera: ForeignCamera) -> tuple[ColmapModel, list[float]] | None:
    """The simplest model of COLMAP that represents a px camera exactly, and its parameters; None if there is none."""
    given = {name: element(camera, name) for name in camera.model.elements}
    if camera.model is DISTORTION_FREE and given.get("pixel_size", 1.0) != 1.0:
        given["principal_distance"] /= given["pixel_size"]
    f, b1 = given["principal_distance"], given.get("b1", 0.0)
    given |= {"f": f, "fx": f + b1, "fy": f}
    affine = ("principal_distance", "b1", "pixel_size", "y_axis", "f", "fx", "fy")
    needed = {name for name, value in given.items() if value and name not in affine} | ({"fx"} if b1 else set())
    own = METASHAPE if camera.model is DISTORTION_FREE else camera.model
    for model in _WRITTEN:
        same = model.model is own or (own is METASHAPE and model.model is RATIONAL and "K4" not in needed)
        if same and needed - {"x0", "y0"} <= set(model.parameters):
            return model, [given.get(name, 0.0) for name in model.parameters]
    return None
