"""Description of a flight: camera, strips, terrain, tie points, control, navigation, and their errors.

Only host data: `simulate_flight` makes a block of a `FlightPlan`, `lines` and `ground` compute positions.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from jaxbundle.camera.additional_parameters import GRID_SHARE
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.camera.model import CameraModel

# share of the flying height: deviations of stations from their nominal positions, and of approximate values
SCATTER = 0.01
TIE_LAYOUTS = ("jittered", "grid", "random", "schematic")
CONTROL_LAYOUTS = ("rows", "corners", "perimeter", "grid", "chains", "points")
CONTROL_KINDS = {"full": (True, True, True), "plan": (True, True, False), "height": (False, False, True)}
SYSTEMATIC_OF = ("none", "block", "strip")


@dataclass(frozen=True)
class AerialCamera:
    """A camera and its true interior orientation. Lengths in mm; rays of a camera with a pixel size are in px.

    `offset`: principal point from the centre of the format, x right, y up. `distortion` is the name of the camera
    model; by default "brown" with `coefficients`, otherwise "none". Elements in `estimate` are unknown and start from
    the centre of the format, from coefficients 0 and from a principal distance 0.2 % too long. `errors`: true minus
    given values of fixed elements, such as from an old calibration.

    Example:
        >>> jb.planning.AerialCamera(principal_distance=100.0, width=104.0, height=68.0, pixel_size=0.006).pixel_size
        0.006
    """

    principal_distance: float = 153.0
    width: float = 230.0
    height: float = 230.0
    pixel_size: float | None = None
    offset: tuple[float, float] = (0.0, 0.0)
    coefficients: Mapping[str, float] = field(default_factory=dict)
    estimate: tuple[str, ...] = ()
    distortion: str | None = None
    errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def model(self) -> CameraModel:
        """The camera model of this camera.

        Raises: ValueError for an unknown model.
        """
        if self.distortion is None:
            plain = set(self.coefficients) | set(self.estimate) <= set(DISTORTION_FREE.elements)
            return DISTORTION_FREE if plain else BROWN
        if self.distortion not in CAMERA_MODELS:
            raise ValueError(f"no camera model '{self.distortion}'; there are {', '.join(CAMERA_MODELS)}")
        return CAMERA_MODELS[self.distortion]

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of the format, unit and axes of the rays."""
        s = self.pixel_size
        return (self.width / 2 / s, self.height / 2 / s) if s else (0.0, 0.0)

    def interior(self) -> dict[str, float]:
        """True interior elements in the order of the model."""
        return {element: value + self.errors.get(element, 0.0) for element, value in self.given().items()}

    def given(self) -> dict[str, float]:
        """Given interior elements of the block, in the order of the model."""
        s, y_axis = (self.pixel_size, -1.0) if self.pixel_size else (1.0, 1.0)
        (x, y), (dx, dy) = self.centre, self.offset
        given = {"x0": x + dx / s, "y0": y + y_axis * dy / s, "pixel_size": s, "y_axis": y_axis}
        given |= {"grid_base": GRID_SHARE * max(self.width, self.height), **self.coefficients}
        given["principal_distance"] = self.principal_distance
        return {element: given.get(element, 0.0) for element in self.model.elements}


FRAME_CAMERA = AerialCamera()


@dataclass(frozen=True)
class Terrain:
    """Heights of the ground of a flight.

    `relief`: range of independent random heights of the points; `heights`: a function of X and Y, arrays in object
    units, that is added.

    Example:
        >>> jb.planning.Terrain(heights=jb.planning.slope(0.1, 0.0)).relief
        0.0
    """

    relief: float = 0.0
    heights: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def at(self, x: Float[np.ndarray, " point"], y: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
        """Heights without the random part."""
        return np.zeros(len(x)) if self.heights is None else np.broadcast_to(self.heights(x, y), x.shape).astype(float)


@dataclass(frozen=True)
class Ties:
    """Number and layout of the tie points of a flight.

    `layout`: "jittered", a grid whose points are shifted at random, "grid", "random", or "schematic", columns at the
    stations and `rows` rows per strip distance, among them the axes of the strips. Control and check points of a
    schematic layout are at the nearest tie points.

    Example:
        >>> jb.planning.Ties("grid", points_per_image=40).layout
        'grid'
    """

    layout: str = "jittered"
    points_per_image: int = 60
    rows: int = 2


@dataclass(frozen=True)
class ControlSet:
    """Control points of one layout.

    "rows": `count` rows across the strips, strips + 1 points each; "corners"; "perimeter" and "grid": `count` points
    along and across the strips, or one per `every` bases; "chains": rows across the strips with a distance of `every`
    bases and a point in each side lap; "points": `points`, X and Y in object units.

    `kind`: "full", "plan" or "height". `sigmas` of X, Y, Z; 0 fixes a coordinate.

    Example:
        >>> jb.planning.ControlSet("corners", sigmas=(0.02, 0.02, 0.03)).kind
        'full'
    """

    layout: str = "rows"
    kind: str = "full"
    sigmas: tuple[float, ...] = (0.0, 0.0, 0.0)
    count: int | None = None
    every: float = 2.0
    points: tuple[tuple[float, float], ...] = ()

    @property
    def known(self) -> Float[np.ndarray, "3"]:
        """Standard deviations of X, Y, Z; NaN if not observed."""
        return np.where(CONTROL_KINDS[self.kind], self.sigmas, np.nan)


@dataclass(frozen=True)
class Navigation:
    """Centres or attitudes observed in flight; lengths in object units, angles in radians.

    `systematic`: whether there are no unknown shifts and drifts, or one set for the whole block or for each strip.
    Their true values are drawn with the standard deviations `shift` and `drift` (per exposure). `offset`: lever arm
    from the projection centre to the antenna in the image system, or boresight angles; `offset_unknown`: the block
    estimates it.

    Example:
        >>> jb.planning.Navigation((0.05, 0.05, 0.1), "strip").systematic
        'strip'
    """

    sigmas: tuple[float, ...]
    systematic: str = "none"
    shift: float = 0.0
    drift: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset_unknown: bool = False

    @property
    def plain(self) -> bool:
        """Whether there are no systematic errors."""
        return self.systematic == "none" and not any(self.offset) and not self.offset_unknown


@dataclass(frozen=True)
class GrossErrors:
    """Gross errors: a share of the rays has an additional error of `size` standard deviations in x or y.

    Example:
        >>> jb.planning.FlightPlan(gross_errors=jb.planning.GrossErrors(share=0.01)).gross_errors.size
        20.0
    """

    share: float = 0.0
    size: float = 20.0


@dataclass(frozen=True)
class FlightPlan:
    """A flight over mean ground 0, or over its terrain; lengths in metres, angles in radians.

    Strips are flown along the local x axis, which points to `heading`, counted clockwise from the Y axis; the first
    station of the first strip is `origin`. With an `area`, a polygon of X and Y, the numbers of strips and images are
    computed for each of `headings`. `cross_strips` are flown across all strips at these shares of their length. `tilt`
    and `scatter` (share of the height) are standard deviations of angles and stations relative to their nominal values.
    `check_points`: a number of tie points, or X and Y of points. `noise` scales all random errors.

    Example:
        >>> jb.planning.FlightPlan(strips=3, images=10, height=900.0).forward_overlap
        0.6
    """

    strips: int = 1
    images: int = 8
    camera: AerialCamera = FRAME_CAMERA
    height: float = 1500.0
    forward_overlap: float = 0.6
    side_overlap: float = 0.3
    headings: tuple[float, ...] = (math.pi / 2,)
    origin: tuple[float, float] = (0.0, 0.0)
    area: tuple[tuple[float, float], ...] = ()
    cross_strips: tuple[float, ...] = ()
    back_and_forth: bool = True
    tilt: float = math.radians(2.0)
    scatter: float = SCATTER
    terrain: Terrain = Terrain(150.0)
    ties: Ties = Ties()
    image_sigma: float | None = None
    control: tuple[ControlSet, ...] = ()
    check_points: int | tuple[tuple[float, float], ...] = 0
    gnss: Navigation | None = None
    ins: Navigation | None = None
    gross_errors: GrossErrors = GrossErrors()
    noise: float = 1.0
    seed: int = 0
    name: str = ""

    @property
    def sigma(self) -> float:
        """Standard deviation of an image coordinate, unit of the rays: by default 0.005 mm or 0.3 px."""
        return self.image_sigma if self.image_sigma is not None else 0.3 if self.camera.pixel_size else 0.005

    @property
    def scale_number(self) -> float:
        """Scale number m: lengths in the image, in the unit of the rays, times m are lengths in object units."""
        unit = self.camera.pixel_size or 1.0
        return self.height / self.camera.principal_distance * unit


def schematic(**changes: object) -> FlightPlan:
    """Makes a regular flight, as in the literature: vertical images at equal distances over flat ground.

    153 mm, 230 x 230 mm, 60 % and 20 % overlap, no errors, tie points in columns at the stations and in rows at the
    axes of the strips and half-way. The keywords are the fields of `FlightPlan`.

    Example:
        >>> plan = jb.planning.schematic(strips=5, images=11, control=(jb.planning.ControlSet("corners"),))
        >>> plan.strips, plan.side_overlap
        (5, 0.2)
    """
    nominal = FlightPlan(
        side_overlap=0.2,
        back_and_forth=False,
        tilt=0.0,
        scatter=0.0,
        terrain=Terrain(),
        ties=Ties("schematic"),
        noise=0.0,
    )
    return replace(nominal, **changes)  # type: ignore[arg-type]


def plan_problems(plan: FlightPlan) -> list[str]:
    """All problems of a flight plan, each with its cure."""
    camera, found = plan.camera, []
    if plan.strips < 1 or plan.images < 2:
        found.append(f"{plan.strips} strips of {plan.images} images; a block needs at least 1 strip of 2 images")
    overlaps = plan.forward_overlap, plan.side_overlap
    if not all(0 <= overlap < 1 for overlap in overlaps) or overlaps[0] < 0.5:
        found.append(f"overlaps {overlaps}; forward overlap is from 0.5 to below 1, side overlap from 0 to below 1")
    if camera.distortion is None or camera.distortion in CAMERA_MODELS:
        model = camera.model
        unknown = [name for name in (*camera.coefficients, *camera.errors) if name not in model.elements]
        unknown += [name for name in camera.estimate if name not in model.estimable]
        if unknown:
            found.append(f"no interior element {', '.join(unknown)}; there are {', '.join(model.estimable)}")
    else:
        found.append(f"no camera model '{camera.distortion}'; there are {', '.join(CAMERA_MODELS)}")
    positive = {"height": plan.height, "image sigma": plan.sigma, "tie points per image": plan.ties.points_per_image}
    found += [f"the {name} is {value}; give a positive number" for name, value in positive.items() if not value > 0]
    found += [
        f"a cross strip at {x} of the length; give shares from 0 to 1" for x in plan.cross_strips if not 0 <= x <= 1
    ]
    names: dict[str, tuple[str, tuple[str, ...]]] = {"tie point layout": (plan.ties.layout, TIE_LAYOUTS)}
    for number, control in enumerate(plan.control, 1):
        names[f"layout of control {number}"] = control.layout, CONTROL_LAYOUTS
        names[f"kind of control {number}"] = control.kind, tuple(CONTROL_KINDS)
        if len(control.sigmas) != 3:
            found.append(f"control {number} has {len(control.sigmas)} sigmas; give those of X, Y and Z")
        if not control.every > 0 or (control.count is not None and control.count < 1):
            found.append(
                f"control {number} has a distance of {control.every} and {control.count} points; give positive numbers"
            )
    for name, navigation in (("gnss", plan.gnss), ("ins", plan.ins)):
        if navigation is not None:
            names[f"systematic errors of {name}"] = navigation.systematic, SYSTEMATIC_OF
            if len(navigation.sigmas) != 3 or not min(navigation.sigmas) > 0:
                found.append(f"sigmas of {name} are {navigation.sigmas}; give three positive numbers")
    found += [
        f"the {name} {value!r} is unknown; there are {', '.join(known)}"
        for name, (value, known) in names.items()
        if value not in known
    ]
    if plan.area and len(plan.area) < 3:
        found.append(f"the area has {len(plan.area)} corners; give 3 or more")
    if not 0 <= plan.gross_errors.share < 0.5:
        found.append(f"the share of gross errors is {plan.gross_errors.share}; give a share from 0 to below 0.5")
    return found
