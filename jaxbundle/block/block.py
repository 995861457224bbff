"""A photogrammetric block: cameras, images, object points and everything observed.

Structure and values are apart. `Structure` (names, who sees what, which elements are unknown) is host data and static
under jit; the values (coordinates, angles, interior elements, observations and their sigmas) are the leaves of `Block`,
a pytree. So an adjustment can be traced, differentiated and vmapped in every value.

Units: object coordinates and image coordinates in the user's units, angles in radians.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.facade import Facade
from jaxbundle.block.findings import Finding
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.block.wording import counted
from jaxbundle.camera.fiducials import InnerOrientation
from jaxbundle.camera.model import CameraModel, mixture
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics.host import array_module, freeze_arrays, is_concrete, on_device, on_host

CENTRE_ELEMENTS = ("X0", "Y0", "Z0")
DISTANCES, COORDINATES = ("principal_distance", "f"), ("x0", "y0")  # interior elements that are lengths in the image


@dataclass(frozen=True)
class Camera:
    """One camera's host data. `image_unit` "px" (v down) or "mm" (y up); sizes in px, None where unknown."""

    name: str
    model: CameraModel
    image_unit: str = "px"
    width: int | None = None
    height: int | None = None
    metric: bool = False  # a px camera whose principal distance is in mm: it has a pixel size

    def unit_of(self, element: str) -> str:
        """Unit of an interior element, "" of one without a unit, as most coefficients are."""
        if element in COORDINATES:  # of the principal point, in the unit of the rays even where there is a pixel size
            return self.image_unit
        return ("mm" if self.metric else self.image_unit) if element in DISTANCES else ""


class Owner(NamedTuple):
    """Whose a parameter is: a row of a table, such as ("planes", "roof"), or the group of a section, ("navigation",
    "strip 1")."""

    table: str
    name: str

    @property
    def words(self) -> str:
        """The owner in a sentence: "plane roof"; of a navigation group its name alone."""
        return self.name if self.table == "navigation" else f"{self.table.removesuffix('s')} {self.name}"


@dataclass(frozen=True)
class Parameter:
    """An unknown that is no coordinate, angle or interior element, as a shift of the navigation data; `unit` as the
    user reads it, "" where it has none; `angle`: it is one, in radians inside. `owner`: what it belongs to, if it is
    not an unknown of its own; several parameters may have the same one."""

    name: str
    unit: str = ""
    free: bool = True
    angle: bool = False
    owner: Owner | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Datum:
    """What fixes origin, axes and scale.

    `kind`: "control" (control points and observed stations), "fixed" (elements the user holds), "minimal" (7 elements
    chosen by the package), "inner" (free network), "open" (nothing yet). `held` names (image, element).

    `carriers`: what gives the system of a datum by control, in words.

    Of a free network: `points` that carry the inner constraints, all if empty; `constraints`, their number, is 0 until
    the package has chosen what it holds meanwhile.
    """

    kind: str
    held: tuple[tuple[str, str], ...] = ()
    points: tuple[str, ...] = ()
    constraints: int = 0
    carriers: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.kind == "inner":
            carrying = f"{len(self.points)} chosen points" if self.points else "all object points"
            return f"free network, {self.constraints or 'inner'} inner constraints over {carrying}"
        if not self.held:
            words = " and ".join(self.carriers) or "control points and observed stations"
            return {"control": words, "open": "none"}.get(self.kind, self.kind)
        elements: dict[str, list[str]] = {}
        for image, element in self.held:
            elements.setdefault(image, []).append(element)
        held = "; ".join(f"image {image}: {', '.join(names)}" for image, names in elements.items())
        return f"{self.kind}, held at their approximate values: {held}"


@dataclass(frozen=True, eq=False)
class Structure:
    """Names, incidences and which elements are unknown. Compared by identity: static under jit, so its arrays are
    read-only; `dataclasses.replace` makes a changed structure.

    `exterior_free` orders X0, Y0, Z0 and the three angles of `rotation_system`; `interior_free` orders the elements of
    each camera's model, padded with False.
    """

    name: str
    cameras: tuple[Camera, ...]
    image_names: tuple[str, ...]
    point_names: tuple[str, ...]
    image_camera: Int[np.ndarray, " image"]
    ray_image: Int[np.ndarray, " ray"]
    ray_point: Int[np.ndarray, " ray"]
    exterior_free: Bool[np.ndarray, "image 6"]
    interior_free: Bool[np.ndarray, "camera element"]
    point_free: Bool[np.ndarray, "point 3"]
    check_point: Int[np.ndarray, " check"]
    datum: Datum = Datum("open")
    rotation_system: RotationSystem = OMEGA_PHI_KAPPA
    object_unit: str = "m"
    angle_unit: str = "deg"
    parameters: tuple[Parameter, ...] = ()
    source: str = ""
    findings: tuple[Finding, ...] = ()  # what reading and preparing the block found
    inner_orientations: tuple[InnerOrientation, ...] = ()  # fits that brought the rays of scanned film from px to mm

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def exterior_elements(self) -> tuple[str, ...]:
        """X0, Y0, Z0 and the names of the angles."""
        return (*CENTRE_ELEMENTS, *self.rotation_system.angles)

    @cached_property
    def model(self) -> CameraModel:
        """The one camera model of all rays; where cameras differ, their mixture."""
        return mixture(tuple(camera.model for camera in self.cameras))

    @cached_property
    def interior_columns(self) -> tuple[int, ...]:
        """Positions of the interior elements that some camera estimates."""
        return tuple(int(k) for k in np.nonzero(self.interior_free.any(0))[0])

    @cached_property
    def ray_repeat(self) -> Int[np.ndarray, " ray"]:
        """Number of rays of the same image and point before each ray: 0 unless the point is measured again there."""
        pair = self.ray_point.astype(np.int64) * len(self.image_names) + self.ray_image
        repeat = np.zeros(len(pair), np.int64)
        if not (np.diff(pair) > 0).all():  # else they are in order and differ
            order = np.argsort(pair, kind="stable")
            repeat[order] = np.arange(len(pair)) - np.searchsorted(pair[order], pair[order])
        repeat.setflags(write=False)
        return repeat

    @property
    def parameter_free(self) -> Bool[np.ndarray, " parameter"]:
        """Which parameters are unknown."""
        return np.array([parameter.free for parameter in self.parameters], bool)

    @property
    def unknowns(self) -> int:
        """N: number of unknown elements."""
        masks = self.exterior_free, self.interior_free, self.parameter_free, self.point_free
        return int(sum(mask.sum() for mask in masks))


class ExteriorOrientation(eqx.Module):
    """Projection centres in the object system, angles in radians in the block's rotation system."""

    projection_centre: Float[Array, "image 3"]
    angles: Float[Array, "image 3"]


class InteriorOrientation(eqx.Module):
    """Interior elements of every camera, in the order of its model, padded with ones."""

    elements: Float[Array, "camera element"]


class Rays(eqx.Module):
    """What is measured of each ray, image coordinates of photographs, and the standard deviations of its residuals."""

    coordinates: Float[Array, "ray number"]
    """In the unit of the camera's rays."""
    sigmas: Float[Array, "ray component"]


class CheckPoints(eqx.Module):
    """Known coordinates that take no part in the adjustment; NaN where a coordinate is not known."""

    coordinates: Float[Array, "check 3"]
    sigmas: Float[Array, "check 3"]


class Block(Facade):
    """A block: structure (static) and values (leaves). `object_points` and orientations are approximate or adjusted."""

    structure: Structure = eqx.field(static=True)
    exterior: ExteriorOrientation
    interior: InteriorOrientation
    object_points: Float[Array, "point 3"]
    rays: Rays
    groups: tuple[ObservationGroup, ...]
    check_points: CheckPoints
    parameters: Float[Array, " parameter"] = eqx.field(default_factory=lambda: on_device(np.zeros(0)))

    def __repr__(self) -> str:
        s = self.structure
        counts = [counted(len(s.image_names), "image"), counted(len(s.point_names), "point")]
        counts += [counted(len(s.ray_image), "ray"), counted(len(s.cameras), "camera")]
        others: dict[str, int] = {}
        for group in self.groups:
            table = group.structure.kind.table
            others[table] = others.get(table, 0) + group.count
        counts += [f"{count} {name}" for name, count in others.items()]
        return f"<Block {s.name or '(unnamed)'}: {', '.join(counts)}>"

    @property
    def observations(self) -> int:
        """M: number of observed values."""
        return self.structure.model.components * len(self.structure.ray_image) + sum(
            group.count for group in self.groups
        )

    @property
    def redundancy(self) -> int:
        """M - N, and the constraints of a free network whose elements are all unknown."""
        structure = self.structure
        inner = 0 if structure.datum.held else structure.datum.constraints
        return self.observations - structure.unknowns + inner

    @property
    def concrete(self) -> bool:
        """Whether the values are numbers, not tracers of a jit, grad or vmap."""
        return is_concrete(self)

    def moved(self, shift: Float[Array | np.ndarray, "3"]) -> "Block":
        """The same block in an object system whose origin lies at -shift: every coordinate grows by `shift`."""
        shift = on_host(shift)

        def moved(coordinates: Float[Array, "entity 3"]) -> Float[Array, "entity 3"]:
            return on_device(on_host(coordinates) + shift)

        def moved_group(group: ObservationGroup) -> ObservationGroup:
            kind = group.structure.kind
            if kind.in_object_system:
                group = eqx.tree_at(lambda g: g.values, group, moved(group.values))
            by = [shift["XYZ".index(name)] if name in ("X", "Y", "Z") else 0.0 for name in kind.constants]
            if kind.constants:
                xp = array_module(shift)
                group = eqx.tree_at(lambda g: g.constants, group, on_device(on_host(group.constants) + xp.stack(by)))
            return group

        groups = tuple(map(moved_group, self.groups))
        return eqx.tree_at(
            lambda b: (b.exterior.projection_centre, b.object_points, b.groups, b.check_points.coordinates),
            self,
            (
                moved(self.exterior.projection_centre),
                moved(self.object_points),
                groups,
                moved(self.check_points.coordinates),
            ),
        )
