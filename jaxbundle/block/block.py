"""A photogrammetric block: cameras, images, object points and all observations.

Structure and values are separate. `Structure` (names, indices of images and points, which elements are unknown) is host
data and static under jit. The values (coordinates, angles, interior elements, observations and their sigmas) are the
leaves of the pytree `Block`. So an adjustment can be traced, differentiated and vmapped with respect to all values.

Units: object coordinates and image coordinates in the user's units, angles in radians.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.facade import Facade
from jaxbundle.block.findings import Finding
from jaxbundle.block.notebook import result_html
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.block.wording import counted
from jaxbundle.camera.fiducials import InnerOrientation
from jaxbundle.camera.model import CameraModel, mixture
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, RotationSystem
from jaxbundle.numerics.host import freeze_arrays, is_concrete, on_device, on_host_or_traced

MAX_CAMERAS = 5  # named where a block shows itself
CENTRE_ELEMENTS = ("X0", "Y0", "Z0")
DISTANCES, COORDINATES = (
    ("principal_distance", "f"),
    ("x0", "y0"),
)  # interior elements with the unit of image coordinates


@dataclass(frozen=True)
class Camera:
    """Static data of one camera. `image_unit`: "px" (v down) or "mm" (y up); sizes in px, None where unknown.

    Example:
        >>> camera = block.structure.cameras[0]
        >>> camera.name, camera.image_unit, camera.model.name
        ('drone', 'px', 'none')
    """

    name: str
    model: CameraModel
    image_unit: str = "px"
    width: int | None = None
    height: int | None = None
    principal_distance_in_mm: bool = False  # a px camera with a pixel size

    def unit_of(self, element: str) -> str:
        """Unit of an interior element; "" without a unit, such as for most coefficients."""
        if element in COORDINATES:  # elements of the principal point, in the unit of the rays also with a pixel size
            return self.image_unit
        return ("mm" if self.principal_distance_in_mm else self.image_unit) if element in DISTANCES else ""


class Owner(NamedTuple):
    """The owner of a parameter.

    A row of a table, such as ("planes", "roof"), or a navigation group, such as ("navigation", "strip 1").
    """

    table: str
    name: str

    @property
    def words(self) -> str:
        """The owner in a sentence: "plane roof"; for a navigation group only its name."""
        return self.name if self.table == "navigation" else f"{self.table.removesuffix('s')} {self.name}"


@dataclass(frozen=True)
class Parameter:
    """An unknown that is not a coordinate, angle or interior element, such as a shift of navigation data.

    `unit`: unit in reports, "" if there is none; `angle`: whether it is an angle, internally in radians. `owner`: the
    object that it describes, if any; several parameters may have the same owner.

    Example:
        >>> jb.blocks.Parameter("refraction scale", unit="", free=False)
        Parameter(name='refraction scale', unit='', free=False, angle=False, owner=None)
    """

    name: str
    unit: str = ""
    free: bool = True
    angle: bool = False
    owner: Owner | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Datum:
    """The datum, which fixes origin, axes and scale.

    `kind`: "control" (control points and observed stations), "fixed" (elements that the user fixes), "minimal" (7
    elements chosen by the package), "inner" (free network), "open" (not yet defined). `held`: the fixed elements as
    (image, element).

    `carriers`: words for the observations that define a datum of kind "control".

    For a free network: `points` of the inner constraints, all points if empty. `constraints`, their number, is 0 until
    the package has chosen elements that it fixes temporarily.

    Example:
        >>> block.structure.datum.kind
        'open'
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
        return f"{self.kind}, fixed at their approximate values: {held}"


@dataclass(frozen=True, eq=False)
class Structure:
    """The static part of a block: names, indices, and which elements are unknown.

    Structures are compared by identity, because they are static under jit. Therefore their arrays are read-only;
    `dataclasses.replace` makes a changed structure.

    Columns of `exterior_free` are X0, Y0, Z0 and the three angles of `rotation_system`; columns of `interior_free` are
    the elements of each camera's model, padded with False.

    Example:
        >>> block.structure.image_names, block.structure.point_names[:3]
        (('11', '12', '21', '22'), ('A', 'B', 'C'))
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
    findings: tuple[Finding, ...] = ()  # findings of reading and preparing the block
    inner_orientations: tuple[
        InnerOrientation, ...
    ] = ()  # fits that transformed the rays of scanned film from px to mm

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def exterior_elements(self) -> tuple[str, ...]:
        """Names of the exterior elements: X0, Y0, Z0 and the three angles."""
        return (*CENTRE_ELEMENTS, *self.rotation_system.angles)

    @cached_property
    def model(self) -> CameraModel:
        """The common camera model of all rays; a mixture if cameras have different models."""
        return mixture(tuple(camera.model for camera in self.cameras))

    @cached_property
    def interior_columns(self) -> tuple[int, ...]:
        """Indices of the interior elements that any camera estimates."""
        return tuple(int(k) for k in np.nonzero(self.interior_free.any(0))[0])

    @cached_property
    def ray_repeat(self) -> Int[np.ndarray, " ray"]:
        """Number of earlier rays with the same image and point, for each ray: 0 for the first measurement."""
        pair = self.ray_point.astype(np.int64) * len(self.image_names) + self.ray_image
        repeat = np.zeros(len(pair), np.int64)
        if not (np.diff(pair) > 0).all():  # otherwise all are in order and different
            order = np.argsort(pair, kind="stable")
            repeat[order] = np.arange(len(pair)) - np.searchsorted(pair[order], pair[order])
        repeat.setflags(write=False)
        return repeat

    @cached_property
    def rays_of_camera(self) -> tuple[Int[np.ndarray, " _ray"], ...]:
        """Indices of the rays of each camera, in ascending order."""
        camera = self.image_camera[self.ray_image]
        order = np.argsort(camera, kind="stable")
        order.setflags(write=False)
        return tuple(np.split(order, np.searchsorted(camera[order], np.arange(1, len(self.cameras)))))

    @property
    def rays_downward(self) -> Bool[np.ndarray, " ray"]:
        """Mask of the rays whose y is measured downward: those in pixels."""
        return np.array([camera.image_unit == "px" for camera in self.cameras])[self.image_camera[self.ray_image]]

    @property
    def parameter_free(self) -> Bool[np.ndarray, " parameter"]:
        """Mask of the unknown parameters."""
        return np.array([parameter.free for parameter in self.parameters], bool)

    @property
    def n_unknowns(self) -> int:
        """N: number of unknown elements."""
        masks = self.exterior_free, self.interior_free, self.parameter_free, self.point_free
        return int(sum(mask.sum() for mask in masks))


class ExteriorOrientation(eqx.Module):
    """Projection centres in the object system, angles in radians in the block's rotation system.

    Example:
        >>> block.exterior.projection_centre.shape, np.degrees(block.exterior.angles[2])
        ((4, 3), array([  0.,   0., 180.]))
    """

    projection_centre: Float[Array, "image 3"]
    angles: Float[Array, "image 3"]


class InteriorOrientation(eqx.Module):
    """Interior elements of each camera, in the order of its model, padded with ones.

    Example:
        >>> elements = block.structure.cameras[0].model.elements
        >>> dict(zip(elements, block.interior.elements[0].tolist()))["principal_distance"]
        4000.0
    """

    elements: Float[Array, "camera element"]


class Rays(eqx.Module):
    """Measurements of each ray (image coordinates, for photographs) and the standard deviations of its residuals.

    Example:
        >>> block.rays.coordinates.shape, block.rays.sigmas[0]
        ((32, 2), Array([0.5, 0.5], dtype=float64))
    """

    coordinates: Float[Array, "ray number"]
    """In the unit of the camera's rays."""
    sigmas: Float[Array, "ray component"]


class CheckPoints(eqx.Module):
    """Known coordinates that are not used in the adjustment; NaN where a coordinate is unknown.

    Example:
        >>> block.check_points.coordinates.shape, block.structure.check_point
        ((1, 3), array([4], dtype=int32))
    """

    coordinates: Float[Array, "check 3"]
    sigmas: Float[Array, "check 3"]


class Block(Facade):
    """A block: structure (static) and values (leaves). `object_points` and orientations are approximate or adjusted.

    Example:
        >>> block
        <Block quarry: 4 images, 8 points, 32 rays, 1 camera, 12 control>
        >>> block.points["E"].coordinates.shape
        (3,)
    """

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

    def _repr_html_(self) -> str:
        s = self.structure
        cameras = [f"{camera.name} ({camera.model.name})" for camera in s.cameras[:MAX_CAMERAS]]
        more = f" and {len(s.cameras) - MAX_CAMERAS} more" if len(s.cameras) > MAX_CAMERAS else ""
        others = [f"{group.count} {group.structure.kind.table}" for group in self.groups]
        rows = [
            ("images", str(len(s.image_names))),
            ("cameras", ", ".join(cameras) + more),
            ("object points", f"{len(s.point_names)}, of which {len(s.check_point)} are check points"),
            ("rays", str(len(s.ray_image))),
            ("other observations", ", ".join(others) or "none"),
            ("datum", str(s.datum)),
            ("units", f"object {s.object_unit}, angles {s.angle_unit}"),
        ]
        return result_html(f"Block {s.name or '(unnamed)'}", rows, ())

    @property
    def n_observations(self) -> int:
        """M: number of observed values."""
        return self.structure.model.components * len(self.structure.ray_image) + sum(
            group.count for group in self.groups
        )

    @property
    def redundancy(self) -> int:
        """M - N, plus the number of constraints of a free network in which all elements are unknown."""
        structure = self.structure
        inner = 0 if structure.datum.held else structure.datum.constraints
        return self.n_observations - structure.n_unknowns + inner

    @property
    def concrete(self) -> bool:
        """Whether the values are numbers, not tracers of a jit, grad or vmap."""
        return is_concrete(self)

    def moved(self, shift: Float[Array | np.ndarray, "3"]) -> "Block":
        """Returns the block in a shifted object system: `shift` is added to all object coordinates."""

        def parts(block: Block) -> tuple:
            return block.exterior.projection_centre, block.object_points, block.check_points.coordinates, block.groups

        return eqx.tree_at(parts, self, _moved(parts(self), shift))


@on_host_or_traced
def _moved(_xp: Any, parts: tuple, shift: Any) -> tuple:
    *coordinates, groups = parts
    return *(x + shift[None] for x in coordinates), tuple(_moved_group(group, shift) for group in groups)


def _moved_group(group: ObservationGroup, shift: Float[Array | np.ndarray, "3"]) -> ObservationGroup:
    """A group in a shifted object system; its arrays are numpy's or traced."""
    kind = group.structure.kind
    if kind.in_object_system:
        group = eqx.tree_at(lambda g: g.values, group, group.values + shift[None])
    if not kind.constants:
        return group
    along = np.array([[name == axis for name in kind.constants] for axis in "XYZ"], float)
    return eqx.tree_at(lambda g: g.constants, group, group.constants + (shift @ along)[None])
