"""Settings of flight.toml: camera, flight, ground, control, navigation, errors, and a specification."""

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from jaxbundle.block.problems import shown
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.io.ranges import Coefficient, Length, PixelSize, PrincipalDistance, Sigma, Triple, problem
from jaxbundle.io.settings import Section, coefficient_names
from jaxbundle.planning.flight import CONTROL_KINDS, CONTROL_LAYOUTS, SYSTEMATIC_OF, TIE_LAYOUTS, AerialCamera

# principal distance, width, height of the format and pixel size in mm: data sheets of the makers
CAMERAS = {
    "film-153": AerialCamera(153.0, 230.0, 230.0),
    "film-305": AerialCamera(305.0, 230.0, 230.0),
    "ultracam-eagle-m3-100": AerialCamera(100.5, 105.84, 68.016, 0.004),
    "dmc-iii": AerialCamera(92.0, 100.3392, 56.9088, 0.0039),
    "zenmuse-p1-35": AerialCamera(35.0, 35.9, 24.0, 0.0044),
    "phantom-4-rtk": AerialCamera(8.8, 13.2, 8.8, 0.00241),
}


def _as_share(value: Any) -> Any:
    """Overlaps of more than 1 are percentages."""
    return value / 100 if isinstance(value, int | float) and not isinstance(value, bool) and value > 1 else value


def _three(value: Any) -> Any:
    """Repeats one number three times."""
    return [float(value)] * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


Overlap = Annotated[float, BeforeValidator(_as_share), Field(ge=0, lt=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Sigmas = Annotated[list[NotNegative], BeforeValidator(_three), Field(min_length=3, max_length=3)]
Place = Annotated[list[Length], Field(min_length=2, max_length=2)]
Degrees = Annotated[float, Field(ge=-360, le=360)]


def _known(name: str, known: tuple[str, ...], what: str) -> str:
    if name not in known:
        raise problem(f"{what} '{shown(name)}' is unknown", f"{meant(name, known)}known: {', '.join(known)}")
    return name


def meant(name: str, known: Sequence[str]) -> str:
    """A question with the most similar known name, such as "did you mean relief?"; "" where no name is similar."""
    match = get_close_matches(name, known, 1)
    return f"did you mean {match[0]}? " if match else ""


class CameraSection(Section):
    """A camera with a known name, or with data in mm; given data replace those of the name."""

    name: str | None = None
    principal_distance: PrincipalDistance | None = None
    width: Positive | None = None
    height: Positive | None = None
    pixel_size: PixelSize | None = None
    offset: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    distortion: str | None = None
    coefficients: dict[str, Coefficient] = {}
    estimate: list[str] = []
    errors: dict[str, float] = {}

    @field_validator("name")
    @classmethod
    def _known_camera(cls, name: str | None) -> str | None:
        return name if name is None else _known(name, tuple(CAMERAS), "camera")

    @field_validator("distortion")
    @classmethod
    def _known_distortion(cls, name: str | None) -> str | None:
        return name if name is None else _known(name, tuple(CAMERA_MODELS), "distortion")

    @model_validator(mode="after")
    def _complete(self) -> "CameraSection":
        data = ("principal_distance", "width", "height")
        missing = [key for key in data if self.name is None and getattr(self, key) is None]
        if missing:
            cure = f"give {'it' if len(missing) == 1 else 'them'} in mm, or the name of a camera: {', '.join(CAMERAS)}"
            raise problem(f"has no {', '.join(missing)}", cure)
        model = self.camera.model
        for kind, names, known in (
            ("coefficient", self.coefficients, coefficient_names(model)),
            ("interior element to estimate", self.estimate, model.estimable),
            ("interior element with an error", self.errors, model.estimable),
        ):
            for name in names:
                _known(name, known, kind)
        return self

    @property
    def camera(self) -> AerialCamera:
        """The camera of these settings."""
        base = CAMERAS[self.name] if self.name else AerialCamera(0.0, 0.0, 0.0)
        return AerialCamera(
            self.principal_distance or base.principal_distance,
            self.width or base.width,
            self.height or base.height,
            self.pixel_size or base.pixel_size,
            (self.offset[0], self.offset[1]),
            self.coefficients,
            tuple(self.estimate),
            self.distortion,
            self.errors,
        )


class FlightSection(Section):
    """Pattern of the flight lines; lengths in metres, overlaps as shares or percentages, angles in degrees."""

    height: Positive | None = None
    scale: Positive | None = None
    gsd: Positive | None = None
    forward_overlap: Overlap = 0.6
    side_overlap: Overlap = 0.3
    strips: Annotated[int, Field(ge=1)] | None = None
    images: Annotated[int, Field(ge=2)] | None = None
    area: Annotated[list[Place], Field(min_length=3)] | None = None
    headings: Annotated[list[Degrees], Field(min_length=1)] = [90.0]
    origin: Place = [0.0, 0.0]
    cross_strips: list[Annotated[float, Field(ge=0, le=1)]] = []
    back_and_forth: bool = True
    tilt: NotNegative = 0.0
    scatter: NotNegative = 0.0

    @field_validator("forward_overlap")
    @classmethod
    def _stereo(cls, overlap: float) -> float:
        if overlap < 0.5:
            raise problem(f"forward_overlap is {overlap}", "give 0.5 or more: each point must lie on two images")
        return overlap

    @model_validator(mode="after")
    def _one_height(self) -> "FlightSection":
        given = [key for key in ("height", "scale", "gsd") if getattr(self, key) is not None]
        if len(given) != 1:
            raise problem(f"has {' and '.join(given) or 'no height'}", "give one of height, scale or gsd")
        if (self.area is None) == (self.strips is None and self.images is None):
            raise problem("has an area and strips, or neither", "give either area, or strips and images")
        if self.area is None and (self.strips is None or self.images is None):
            raise problem("has only one of strips and images", "give both")
        return self


class TerrainSection(Section):
    """The ground: `relief` is a range of heights in metres, `slope` rises along X and Y, `file` a CSV of X, Y, Z."""

    type: Literal["flat", "random", "waves", "slope", "grid"] = "flat"
    relief: NotNegative | None = None
    wavelength: Positive | None = None
    slope: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    file: str | None = None

    @model_validator(mode="after")
    def _complete(self) -> "TerrainSection":
        needs = {"random": ("relief",), "waves": ("relief", "wavelength"), "slope": ("slope",), "grid": ("file",)}
        missing = [key for key in needs.get(self.type, ()) if getattr(self, key) is None]
        if missing:
            raise problem(f"of type {self.type} has no {', '.join(missing)}", f"give {' and '.join(missing)}")
        return self


class TieSection(Section):
    """Number and layout of the tie points."""

    layout: str = "grid"
    points_per_image: Annotated[int, Field(ge=4)] = 60
    rows: Annotated[int, Field(ge=1)] = 2

    @field_validator("layout")
    @classmethod
    def _known_layout(cls, name: str) -> str:
        return _known(name, TIE_LAYOUTS, "layout of tie points")


class ControlSection(Section):
    """Control points of one layout; `sigma` of X, Y, Z in metres, 0 for coordinates without errors."""

    layout: str
    kind: str = "full"
    sigma: Sigmas
    count: Annotated[int, Field(ge=1)] | None = None
    every: Positive = 2.0
    points: list[Place] = []

    @field_validator("layout")
    @classmethod
    def _known_layout(cls, name: str) -> str:
        return _known(name, CONTROL_LAYOUTS, "layout of control")

    @field_validator("kind")
    @classmethod
    def _known_kind(cls, name: str) -> str:
        return _known(name, tuple(CONTROL_KINDS), "kind of control")

    @model_validator(mode="after")
    def _with_points(self) -> "ControlSection":
        if (self.layout == "points") != bool(self.points):
            raise problem("layout = 'points' and the key points need each other", "give both or neither")
        return self


class CheckSection(Section):
    """Check points: a number of tie points, or given positions."""

    count: Annotated[int, Field(ge=0)] = 0
    points: list[Place] = []


class NavigationSection(Section):
    """Observed centres (metres) or attitudes (degrees); `shift` and `drift`: sizes of true systematic errors."""

    sigma: Annotated[list[Sigma], BeforeValidator(_three), Field(min_length=3, max_length=3)]
    systematic: str = "none"
    shift: NotNegative = 0.0
    drift: NotNegative = 0.0
    lever_arm: Triple | None = None
    boresight: Triple | None = None
    estimate_offset: bool = False

    @field_validator("systematic")
    @classmethod
    def _known_group(cls, name: str) -> str:
        return _known(name, SYSTEMATIC_OF, "systematic errors")


class SigmaSection(Section):
    """Standard deviation of image coordinates in the unit of the rays: px, or mm for a camera without pixel size."""

    image: Sigma


class GrossErrorSection(Section):
    """Gross errors of the rays; `size` in standard deviations."""

    share: Annotated[float, Field(ge=0, lt=0.5)]
    size: Positive = 20.0


class SpecificationSection(Section):
    """Maximum standard deviations of X and Y, and of Z, in metres, for a share of the points."""

    xy: Positive
    z: Positive
    share: Annotated[float, Field(gt=0, le=1)] = 0.95


class FlightSettings(Section):
    """All sections of flight.toml."""

    name: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    noise: NotNegative = 1.0
    camera: CameraSection
    flight: FlightSection
    terrain: TerrainSection = TerrainSection()
    ties: TieSection = TieSection()
    sigma: SigmaSection | None = None
    control: list[ControlSection] = []
    check: CheckSection = CheckSection()
    gnss: NavigationSection | None = None
    ins: NavigationSection | None = None
    gross_errors: GrossErrorSection | None = None
    specification: SpecificationSection | None = None


SECTIONS: dict[str, type[Section]] = {
    "camera": CameraSection,
    "flight": FlightSection,
    "terrain": TerrainSection,
    "ties": TieSection,
    "sigma": SigmaSection,
    "control": ControlSection,
    "check": CheckSection,
    "gnss": NavigationSection,
    "ins": NavigationSection,
    "gross_errors": GrossErrorSection,
    "specification": SpecificationSection,
}
