"""What block.toml says: units, rotation system, cameras, datum and the names of the tables of a block folder."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from jaxbundle.camera.model import CAMERA_MODELS, CameraModel
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS

WITH_KEYS = ("principal_distance", "x0", "y0", "pixel_size", "y_axis")  # interior elements that are no coefficients

Positive = Annotated[float, Field(gt=0)]
Pixels = Annotated[int, Field(gt=0)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Names = TypeVar("Names", dict[str, float], list[str])


def _problem(what: str, cure: str) -> PydanticCustomError:
    return PydanticCustomError("problem", "{what}; {cure}", {"what": what, "cure": cure})


def coefficient_names(model: CameraModel) -> tuple[str, ...]:
    """The distortion coefficients of a camera model."""
    return tuple(name for name in model.elements if name not in WITH_KEYS)


class Section(BaseModel):
    """A section of block.toml."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Units(Section):
    """Units of object coordinates and angles."""

    object: Literal["m", "mm"]
    angle: Literal["deg", "gon", "rad"]


class RotationSection(Section):
    """The system of the three angles of images.csv."""

    system: str

    @field_validator("system")
    @classmethod
    def _known(cls, system: str) -> str:
        if system not in ROTATION_SYSTEMS:
            raise _problem(f"rotation system '{system}' is unknown", f"known: {', '.join(ROTATION_SYSTEMS)}")
        return system


class CameraSection(Section):
    """A camera; principal point in the unit of the rays, principal distance in mm or, without pixel size, in px."""

    image_unit: Literal["px", "mm"]
    pixel_size: Positive | None = None
    width: Pixels | None = None
    height: Pixels | None = None
    principal_distance: Positive
    principal_point: Pair | None = None
    distortion: Annotated[str, Field(validate_default=True)] = "none"
    coefficients: dict[str, float] = {}
    estimate: list[str] = []
    fiducials: Any = None

    @property
    def model(self) -> CameraModel:
        """The camera model of this distortion."""
        return CAMERA_MODELS[self.distortion]

    @field_validator("pixel_size")
    @classmethod
    def _of_pixels(cls, size: float | None, info: Any) -> float | None:
        if size is not None and info.data.get("image_unit") == "mm":
            raise _problem("rays in mm have no pixel_size", 'drop it, or give the rays in px and image_unit = "px"')
        return size

    @field_validator("distortion")
    @classmethod
    def _known_and_complete(cls, name: str, info: Any) -> str:
        if name not in CAMERA_MODELS:
            raise _problem(f"distortion '{name}' is unknown", f"known: {', '.join(CAMERA_MODELS)}")
        elements = CAMERA_MODELS[name].elements
        if "x0" in elements and info.data.get("principal_point", ...) is None:
            raise _problem("principal_point is missing", "give principal_point = [x0, y0] in the unit of the rays")
        for key, element in (("principal_point", "x0"), ("pixel_size", "pixel_size")):
            if element not in elements and info.data.get(key) is not None:
                raise _problem(f"distortion '{name}' has no {key}", "drop it")
        return name

    @field_validator("coefficients")
    @classmethod
    def _known_coefficients(cls, values: dict[str, float], info: Any) -> dict[str, float]:
        model = CAMERA_MODELS.get(info.data.get("distortion", ""))
        return _all_known(values, coefficient_names(model), model.name, "coefficient") if model else values

    @field_validator("estimate")
    @classmethod
    def _known_elements(cls, names: list[str], info: Any) -> list[str]:
        model = CAMERA_MODELS.get(info.data.get("distortion", ""))
        return _all_known(names, model.estimable, model.name, "interior element to estimate") if model else names

    @field_validator("fiducials")
    @classmethod
    def _not_available(cls, _: object) -> None:
        raise _problem("fiducials are not available", 'transform the rays to mm and give image_unit = "mm"')


def _all_known(names: Names, known: tuple[str, ...], distortion: str, kind: str) -> Names:
    unknown = [name for name in names if name not in known]
    if unknown:
        what = f"{kind} {', '.join(unknown)} is unknown to distortion '{distortion}'"
        raise _problem(what, f"known: {', '.join(known) or 'none'}")
    return names


class Sigma(Section):
    """Standard deviation of rays that have none of their own, in their unit."""

    image: Positive


class DatumSection(Section):
    """Elements of images that keep their approximate values."""

    type: str
    hold: dict[str, list[str]] = {}
    elements: Any = None

    @field_validator("type")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind == "inner":
            raise _problem("inner constraints are not available", "known: fixed, minimal")
        if kind not in ("fixed", "minimal"):
            raise _problem(f"datum '{kind}' is unknown", "known: fixed, minimal")
        return kind


class TableNames(Section):
    """File names of the tables."""

    images: str
    rays: str
    points: str | None = None
    control: str | None = None
    stations: str | None = None
    distances: str | None = None
    fiducials: Any = None
    fiducial_rays: Any = None

    @field_validator("fiducials", "fiducial_rays")
    @classmethod
    def _not_available(cls, _: object) -> None:
        raise _problem("fiducials are not available", "transform the rays to mm and drop the table")


class Settings(Section):
    """block.toml of format 1."""

    format: Literal[1]
    name: str = ""
    source: str = ""
    units: Units
    rotation: RotationSection
    cameras: Annotated[dict[str, CameraSection], Field(min_length=1)]
    sigma: Sigma | None = None
    datum: DatumSection | None = None
    tables: TableNames


SECTIONS: dict[str, type[Section]] = {
    "units": Units,
    "rotation": RotationSection,
    "cameras": CameraSection,
    "sigma": Sigma,
    "datum": DatumSection,
    "tables": TableNames,
}
