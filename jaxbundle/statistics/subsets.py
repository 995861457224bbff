"""Subsets of the observations, for example with their own variance component or influence.

A subset has a mask for the image coordinates and one for the components of each group of `block.groups`. & is the
intersection and | the union of subsets, such as `control_rays(block) & camera_rays(block, "left")`.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.observation_kinds import ObservationGroup

Mask = Bool[np.ndarray, "_member _component"]
XY = ("X", "Y")
Z = ("Z",)


@dataclass(frozen=True, eq=False)
class Subset:
    """A subset: a name and masks, one for the rays and one for each group, like the tables of residuals.

    Example:
        >>> jb.statistics.tie_rays(block).masks[0].shape
        (32, 2)
    """

    name: str
    masks: tuple[Mask, ...]

    @property
    def count(self) -> int:
        """Number of observations of the subset."""
        return int(sum(mask.sum() for mask in self.masks))

    def __and__(self, other: "Subset") -> "Subset":
        masks = tuple(a & b for a, b in zip(self.masks, other.masks, strict=True))
        return Subset(f"{self.name}, {other.name}", masks)

    def __or__(self, other: "Subset") -> "Subset":
        masks = tuple(a | b for a, b in zip(self.masks, other.masks, strict=True))
        return Subset(f"{self.name} and {other.name}", masks)

    def named(self, name: str) -> "Subset":
        """Returns the subset with another name."""
        return dataclasses.replace(self, name=name)


def all_observations(block: Block, name: str = "all observations") -> Subset:
    """The subset of all observations."""
    rays = np.ones((len(block.structure.ray_image), block.structure.model.components), bool)
    return Subset(name, (rays, *(group.structure.observed for group in block.groups)))


def image_coordinates(block: Block) -> Subset:
    """The subset of both coordinates of all rays."""
    return _rays(block, "image coordinates", np.ones(len(block.structure.ray_image), bool))


def control_rays(block: Block) -> Subset:
    """Group I of Text 001: image coordinates of control points, which have a fixed or observed coordinate.

    Example:
        >>> jb.statistics.control_rays(block).count
        32
    """
    require_a(Block, block, "statistics.control_rays")
    return _rays(block, "rays of control points", is_control_point(block)[block.structure.ray_point])


def tie_rays(block: Block) -> Subset:
    """Group II of Text 001: image coordinates of all other points.

    Example:
        >>> jb.statistics.tie_rays(block).count
        32
    """
    require_a(Block, block, "statistics.tie_rays")
    return _rays(block, "rays of tie points", ~is_control_point(block)[block.structure.ray_point])


def camera_rays(block: Block, camera: str) -> Subset:
    """The subset of image coordinates on the images of one camera.

    Raises: ValueError for an unknown name, as in all functions with names.

    Example:
        >>> jb.statistics.camera_rays(block, "drone").count
        64
    """
    require_a(Block, block, "statistics.camera_rays")
    names = tuple(camera.name for camera in block.structure.cameras)
    (number,) = _numbers("camera", names, [camera])
    return _rays(block, f"rays of camera {camera}", block.structure.image_camera[block.structure.ray_image] == number)


def image_rays(block: Block, images: Collection[str], name: str) -> Subset:
    """The subset of image coordinates on some images, such as a strip; `name` is the name of the strip.

    Example:
        >>> jb.statistics.image_rays(block, ("11", "12"), "strip 1").count
        32
    """
    require_a(Block, block, "statistics.image_rays")
    numbers = _numbers("image", block.structure.image_names, images)
    return _rays(block, name, np.isin(block.structure.ray_image, numbers))


def observations_of_kind(block: Block, kind: str, components: Collection[str] | None = None) -> Subset:
    """The subset of observations of a kind by its name, or of some components, such as XY or Z of "control".

    "stations" are observed projection centres without systematic errors, "gnss_stations" those with such errors.

    Raises: ValueError for a kind or a component that the block does not have.

    Example:
        >>> jb.statistics.observations_of_kind(block, "control", "Z").count
        4
    """
    require_a(Block, block, "statistics.observations_of_kind")
    kinds: dict[str, dict[str, None]] = {}  # cameras of different models have different elements in "interior"
    for group in block.groups:
        kinds.setdefault(group.structure.kind.name, {}).update(dict.fromkeys(group.structure.kind.components))
    if kind not in kinds:
        raise ValueError(f"the block has no observations {kind!r}; there are {', '.join(kinds) or 'none'}")
    wanted = tuple(kinds[kind]) if components is None else tuple(components)
    missing = [component for component in wanted if component not in kinds[kind]]
    if missing:
        raise ValueError(f"{kind} has no component {missing[0]!r}; there are {', '.join(kinds[kind])}")

    def chosen(group: ObservationGroup) -> Mask:
        own = np.isin(group.structure.kind.components, wanted) & (group.structure.kind.name == kind)
        return group.structure.observed & own

    return _members(block, kind if components is None else f"{', '.join(wanted)} of {kind}", chosen)


def control_point(block: Block, point: str) -> Subset:
    """The subset of the observed coordinates of one control point.

    Example:
        >>> jb.statistics.control_point(block, "A").count
        3
    """
    require_a(Block, block, "statistics.control_point")
    (number,) = _numbers("point", block.structure.point_names, [point])

    def chosen(group: ObservationGroup) -> Mask:
        own = (group.structure.indices[:, :1] == number) & _is_coordinates(group)
        return group.structure.observed & own

    subset = _members(block, f"control point {point}", chosen)
    if subset.count == 0:
        raise ValueError(f"point {point} has no observed coordinates; give fixed coordinates a sigma to include them")
    return subset


def observed_points(block: Block) -> tuple[str, ...]:
    """Names of the points with an observed coordinate, in the order of the block."""
    return tuple(block.structure.point_names[p] for p in np.flatnonzero(_is_observed(block)))


def all_control(block: Block) -> Subset:
    """Group III of Text 001: all observations other than image coordinates.

    Example:
        >>> jb.statistics.all_control(block).count
        12
    """
    require_a(Block, block, "statistics.all_control")
    return _members(block, "all control", lambda group: group.structure.observed)


def default_groups(block: Block) -> tuple[Subset, ...]:
    """Groups I and II of Text 001 and, instead of group III, one subset per kind of observation.

    Example:
        >>> len(jb.statistics.default_groups(block))
        3
    """
    require_a(Block, block, "statistics.default_groups")
    kinds = dict.fromkeys(group.structure.kind.name for group in block.groups)
    subsets = control_rays(block), tie_rays(block), *(observations_of_kind(block, kind) for kind in kinds)
    return tuple(subset for subset in subsets if subset.count)


def require_whole_members(block: Block, subset: Subset) -> None:
    """Raises ValueError if a subset contains only some of the correlated components of a member."""
    for group, mask in zip(block.groups, subset.masks[1:], strict=True):
        observed = group.structure.observed
        split = mask.any(1) & (mask != observed).any(1)
        if group.covariances is not None and split.any():
            raise ValueError(
                f"{subset.name} contains some components of {group.structure.kind.name}, which are correlated with"
                " the others: use whole rows of the table, or give sigmas instead of covariances"
            )


def is_control_point(block: Block) -> Bool[np.ndarray, " point"]:
    """Mask of points with a coordinate that is fixed or observed in the object system."""
    return np.any(~block.structure.point_free, axis=1) | _is_observed(block)


def _is_observed(block: Block) -> Bool[np.ndarray, " point"]:
    observed = np.zeros(len(block.structure.point_names), bool)
    for group in block.groups:
        if _is_coordinates(group):
            observed[group.structure.indices[group.structure.observed.any(1), 0]] = True
    return observed


def _is_coordinates(group: ObservationGroup) -> bool:
    """Whether a group observes coordinates of points."""
    kind = group.structure.kind
    return kind.in_object_system and kind.touches == ("point",)


def _rays(block: Block, name: str, mask: Bool[np.ndarray, " ray"]) -> Subset:
    none = (np.zeros_like(group.structure.observed) for group in block.groups)
    return Subset(name, (np.repeat(mask[:, None], block.structure.model.components, 1), *none))


def _members(block: Block, name: str, chosen: Callable[[ObservationGroup], Mask]) -> Subset:
    rays = np.zeros((len(block.structure.ray_image), block.structure.model.components), bool)
    return Subset(name, (rays, *map(chosen, block.groups)))


def _numbers(what: str, names: Sequence[str], wanted: Collection[str]) -> list[int]:
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise ValueError(f"no {what} {unknown[0]!r} in the block")
    return [names.index(name) for name in wanted]
