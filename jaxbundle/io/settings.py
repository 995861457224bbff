"""Settings of block.toml: units, rotation system, cameras, navigation, datum and the files of the tables."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from jaxbundle.block.problems import shown
from jaxbundle.camera.additional_parameters import GRID_SHARE
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.camera.corrections import curvature_coefficient, refraction_coefficient, with_corrections
from jaxbundle.camera.fiducials import PARAMETERS
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import ROTATION_SYSTEMS
from jaxbundle.io.block_tables import REQUIRED, TABLES
from jaxbundle.io.near_names import nearest
from jaxbundle.io.ranges import (
    AnyCase,
    Coefficient,
    Length,
    NotBoolean,
    Pair,
    Pixels,
    PixelSize,
    PrincipalDistance,
    Prior,
    Sigma,
    Triple,
    problem,
)

WITH_KEYS = ("principal_distance", "x0", "y0", "pixel_size", "y_axis")  # interior elements that are not coefficients
SYSTEMATIC = tuple(name for schema in TABLES.values() for name in schema.systematic)
DATUMS = ("fixed", "minimal", "inner")
OTHER_NAMES = {  # names of interior elements in other programs
    **dict.fromkeys(("f", "fx", "fy", "c", "focal", "focal_length"), "principal_distance"),
    **dict.fromkeys(("cx", "ppx", "u0", "xp"), "x0"),
    **dict.fromkeys(("cy", "ppy", "v0", "yp"), "y0"),
}
LARGEST = {
    "refraction": 1e-3,
    "earth_curvature": 0.01,
}  # several times the height of any flight: a larger number is in another unit

Names = TypeVar("Names", dict[str, float], list[str])


def coefficient_names(model: CameraModel) -> tuple[str, ...]:
    """The distortion coefficients of a camera model."""
    return tuple(name for name in model.elements if name not in WITH_KEYS)


class Section(BaseModel):
    """Base of the sections of block.toml."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Units(Section):
    """Units of object coordinates and angles."""

    object: Annotated[Literal["m", "mm"], AnyCase]
    angle: Annotated[Literal["deg", "gon", "rad"], AnyCase]


class RotationSection(Section):
    """The system of the three angles of images.csv."""

    system: Annotated[str, AnyCase]

    @field_validator("system")
    @classmethod
    def _known(cls, system: str) -> str:
        if system not in ROTATION_SYSTEMS:
            raise problem(f"rotation system '{shown(system)}' is unknown", f"known: {', '.join(ROTATION_SYSTEMS)}")
        return system


class Corrections(Section):
    """Refraction and earth curvature of a camera: `true`, from heights in m above sea level, or the coefficient itself.

    The coefficients are K in rad and H / 2R (camera/corrections.py).
    """

    flying_height: Length | None = None
    ground_height: Length | None = None
    refraction: Any = False
    earth_curvature: Annotated[Any, Field(validate_default=True)] = False

    @property
    def coefficients(self) -> dict[str, float]:
        """The two coefficients; 0 without correction."""
        heights = self.flying_height or 0.0, self.ground_height or 0.0
        functions = {"refraction": refraction_coefficient, "earth_curvature": curvature_coefficient}
        given = {name: getattr(self, name) for name in functions}
        return {name: functions[name](*heights) if value is True else float(value) for name, value in given.items()}

    @field_validator("refraction", "earth_curvature")
    @classmethod
    def _sensible(cls, value: Any, info: Any) -> bool | float:
        name, given = info.field_name, info.data
        if not isinstance(value, bool | int | float) or not 0 <= value <= (value is True or LARGEST[name]):
            raise problem(f"{name} is {value!r}", f"give true, false or a coefficient from 0 to {LARGEST[name]}")
        if value is True and {"flying_height", "ground_height"} <= given.keys():
            if given["flying_height"] is None or given["ground_height"] is None:
                cure = "give flying_height and ground_height in m above sea level"
                raise problem(f"{name} = true needs the heights of the flight and of the ground", cure)
            try:
                refraction_coefficient(given["flying_height"], given["ground_height"])
            except ValueError as error:
                raise problem(f"{name}: {error}", "give both heights in m above sea level") from None
        if name == "earth_curvature" and value is False and given.get("refraction") is False:
            raise problem(
                "corrections are neither refraction nor earth_curvature", "set one of them to true, or drop the section"
            )
        return value


class CameraSection(Section):
    """A camera; principal point in the unit of the rays, principal distance in mm or, without pixel size, in px.

    With fiducials both are in mm, in the system of the fiducials, and `pixel_size` is that of the scan.
    """

    image_unit: Annotated[Literal["px", "mm"], AnyCase]
    pixel_size: PixelSize | None = None
    width: Pixels | None = None
    height: Pixels | None = None
    principal_distance: PrincipalDistance
    principal_point: Pair | None = None
    distortion: Annotated[str, Field(validate_default=True)] = "none"
    coefficients: Annotated[dict[str, Coefficient], Field(validate_default=True)] = {}
    estimate: list[str] = []
    priors: dict[str, Prior] | None = None
    corrections: Corrections | None = None
    fiducials: str | None = None

    @property
    def model(self) -> CameraModel:
        """The camera model of this distortion and these corrections."""
        model = CAMERA_MODELS[self.distortion]
        return with_corrections(model) if self.corrections else model

    @property
    def in_mm(self) -> bool:
        """Whether the rays of the block are in mm, x to the right, y up."""
        return self.image_unit == "mm" or self.fiducials is not None

    @field_validator("pixel_size")
    @classmethod
    def _of_pixels(cls, size: float | None, info: Any) -> float | None:
        if size is not None and info.data.get("image_unit") == "mm":
            raise problem("rays in mm have no pixel_size", 'drop it, or give the rays in px and image_unit = "px"')
        return size

    @field_validator("distortion")
    @classmethod
    def _known_and_complete(cls, name: str, info: Any) -> str:
        if name not in CAMERA_MODELS:
            raise problem(f"distortion '{shown(name)}' is unknown", f"known: {', '.join(CAMERA_MODELS)}")
        elements = CAMERA_MODELS[name].elements
        if "x0" in elements and info.data.get("principal_point", ...) is None:
            raise problem("principal_point is missing", "give principal_point = [x0, y0] in the unit of the rays")
        for key, element in (("principal_point", "x0"), ("pixel_size", "pixel_size")):
            if element not in elements and info.data.get(key) is not None:
                raise problem(f"distortion '{name}' has no {key}", "drop it")
        return name

    @field_validator("coefficients")
    @classmethod
    def _known_coefficients(cls, values: dict[str, float], info: Any) -> dict[str, float]:
        model = CAMERA_MODELS.get(info.data.get("distortion", ""))
        if model is None:
            return values
        _all_known(values, coefficient_names(model), model.name, "coefficient")
        return _with_grid_base(values, info.data) if "grid_base" in model.elements else values

    @field_validator("estimate")
    @classmethod
    def _known_elements(cls, names: list[str], info: Any) -> list[str]:
        model = CAMERA_MODELS.get(info.data.get("distortion", ""))
        return _all_known(names, model.estimable, model.name, "interior element to estimate") if model else names

    @field_validator("priors")
    @classmethod
    def _of_unknowns(cls, values: dict[str, float] | None, info: Any) -> dict[str, float] | None:
        return _all_estimated(values, info.data.get("estimate"))

    @field_validator("fiducials")
    @classmethod
    def _known_transformation(cls, name: str | None, info: Any) -> str | None:
        given, model = info.data, CAMERA_MODELS.get(info.data.get("distortion", ""))
        if name is None:
            return name
        if name not in PARAMETERS:
            raise problem(f"fiducials '{shown(name)}' are unknown", f"known: {', '.join(PARAMETERS)}")
        if given.get("image_unit") == "mm":
            raise problem("rays in mm need no fiducials", 'drop them, or give the rays in px and image_unit = "px"')
        if model and "pixel_size" not in model.elements:
            raise problem(
                f"distortion '{model.name}' is for rays in px, but fiducials transform them to mm",
                "use another distortion",
            )
        if given.get("pixel_size", ...) is None:
            raise problem("fiducials need pixel_size", "give the nominal pixel of the scan in mm")
        return name


def _with_grid_base(values: dict[str, float], given: dict[str, Any]) -> dict[str, float]:
    """The coefficients with a grid_base; it is computed from the image format where that has the unit of the rays."""
    if values.get("grid_base", 1.0) <= 0:
        raise problem(f"grid_base is {values['grid_base']}", "give a positive number")
    if "grid_base" in values or not {"image_unit", "pixel_size", "width", "height"} <= given.keys():
        return values
    sides = given["width"], given["height"]
    if None in sides or given["image_unit"] == "mm":
        what = f"distortion '{given['distortion']}' needs grid_base"
        raise problem(what, f"add it to the coefficients: {GRID_SHARE} of the longer side of the image is usual")
    return {**values, "grid_base": GRID_SHARE * max(sides) * (given["pixel_size"] or 1.0)}


def _all_known(names: Names, known: tuple[str, ...], distortion: str, kind: str) -> Names:
    unknown = [name for name in names if name not in known]
    if unknown:
        what = f"{kind} {', '.join(map(shown, unknown))} is unknown to distortion '{distortion}'"
        meant = {name: _meant(name, known) for name in unknown}
        renamed = [f"{ours} for {shown(theirs)}" for theirs, ours in meant.items() if ours]
        did = f"did you mean {', '.join(renamed)}? " if renamed else ""
        raise problem(what, f"{did}known: {', '.join(known) or 'none'}")
    return names


def _meant(name: str, known: tuple[str, ...]) -> str:
    """The known element that another program calls so, or that differs only in case; "" where there is none."""
    other = OTHER_NAMES.get(name, "")
    if other in known:
        return other
    match = nearest([name], known)
    return match.pairs[name] if match else ""


def _all_estimated(values: dict[str, float] | None, estimate: list[str] | None) -> dict[str, float] | None:
    """The priors, after a check that each belongs to an unknown element."""
    held = [name for name in values or () if estimate is not None and name not in estimate]
    if held:
        cure = "name it in estimate, or drop its prior"
        raise problem(f"{', '.join(held)} has a prior and is not estimated", cure)
    return values


class NavigationSection(Section):
    """Systematic errors of a group of stations and attitudes; lengths in the object unit, angles in that of the folder.

    Parameters that are not in `estimate` are fixed; `priors` are standard deviations of the given values.
    """

    lever_arm: Triple | None = None
    shift: Triple | None = None
    drift: Triple | None = None
    boresight: Triple | None = None
    attitude_shift: Triple | None = None
    attitude_drift: Triple | None = None
    estimate: list[str] = []
    priors: dict[str, Prior] | None = None

    @field_validator("estimate")
    @classmethod
    def _known(cls, names: list[str]) -> list[str]:
        unknown = [name for name in names if name not in SYSTEMATIC]
        if unknown:
            cure = f"known: {', '.join(SYSTEMATIC)}"
            raise problem(f"unknown parameters to estimate: {', '.join(unknown)}", cure)
        return names

    @field_validator("priors")
    @classmethod
    def _of_unknowns(cls, values: dict[str, float] | None, info: Any) -> dict[str, float] | None:
        return _all_estimated(values, info.data.get("estimate"))


class SigmaSection(Section):
    """Default standard deviation of rays, in the unit of the rays."""

    image: Sigma


class DatumSection(Section):
    """The datum: elements of images that are fixed at their approximate values, or a free network.

    For a free network: `points` of the inner constraints, all points if none is named, and `elements`, which they fix.
    """

    type: str
    hold: dict[str, list[str]] = {}
    points: list[str] | None = None
    elements: list[str] | None = None

    @field_validator("type")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in DATUMS:
            raise problem(f"datum '{shown(kind)}' is unknown", f"known: {', '.join(DATUMS)}")
        return kind

    @field_validator("hold")
    @classmethod
    def _not_free(cls, held: dict[str, list[str]], info: Any) -> dict[str, list[str]]:
        if held and info.data.get("type") == "inner":
            raise problem("a free network fixes no elements", 'drop hold, or give type = "fixed"')
        return held

    @field_validator("points", "elements", mode="before")
    @classmethod
    def _list(cls, names: Any, info: Any) -> Any:
        if isinstance(names, str):
            cure = 'name points in brackets, points = ["101", "102", "103"]; without the key all object points are used'
            if info.field_name == "elements":
                cure = 'give elements = ["translation", "rotation"], and "scale" where no observation determines it'
            raise problem(f"{info.field_name} is '{shown(names)}', not a list", cure)
        return names

    @field_validator("points", "elements")
    @classmethod
    def _of_a_free_network(cls, names: list[str] | None, info: Any) -> list[str] | None:
        kind = info.data.get("type")
        if names is not None and kind is not None and kind != "inner":
            raise problem(f"datum '{kind}' has no {info.field_name}", 'drop it, or give type = "inner"')
        return names

    @field_validator("points")
    @classmethod
    def _enough(cls, names: list[str] | None) -> list[str] | None:
        if names is not None and len(set(names)) < 3:
            raise problem(f"{len(set(names))} points are too few for inner constraints", "name 3 or more, or none")
        return names

    @field_validator("elements")
    @classmethod
    def _translation_and_rotation(cls, names: list[str] | None) -> list[str] | None:
        if names is not None and set(names) - {"scale"} != {"translation", "rotation"}:
            cure = 'give elements = ["translation", "rotation"], and "scale" where no observation determines it'
            raise problem(f"elements are {', '.join(names) or 'none'}", cure)
        return names


def _known_table(name: str) -> str:
    if name not in TABLES:
        raise problem(f"{shown(name)} is unknown", f"known tables: {', '.join(TABLES)}")
    return name


class Settings(Section):
    """All sections of block.toml, format 1."""

    format: Annotated[Literal[1], NotBoolean]
    name: str = ""
    source: str = ""
    units: Units
    rotation: RotationSection
    cameras: Annotated[dict[str, CameraSection], Field(min_length=1)]
    navigation: dict[str, NavigationSection] | None = None
    sigma: SigmaSection | None = None
    identification: dict[str, Sigma] | None = None
    datum: DatumSection | None = None
    tables: dict[Annotated[str, AfterValidator(_known_table)], str]

    @field_validator("tables")
    @classmethod
    def _complete(cls, files: dict[str, str]) -> dict[str, str]:
        missing = [name for name in REQUIRED if name not in files]
        if missing:
            files = {name: TABLES[name].file for name in missing}
            what, them = ("is missing", "it") if len(missing) == 1 else ("are missing", "them")
            such = ", ".join(f'{name} = "{file}"' for name, file in files.items())
            raise problem(f"{' and '.join(missing)} {what}", f"add {them}, such as {such}")
        return files


SECTIONS: dict[str, type[Section]] = {
    "units": Units,
    "rotation": RotationSection,
    "cameras": CameraSection,
    "corrections": Corrections,
    "navigation": NavigationSection,
    "sigma": SigmaSection,
    "datum": DatumSection,
}
