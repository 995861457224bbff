"""Subsets of the observations, by what they are: they may have a variance component, or an influence, of their own.

A subset is a mask over the image coordinates and one over the components of every group of `block.groups`. Subsets are
met with & and joined with |, as `control_rays(block) & camera_rays(block, "left")`.
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
    """A name and masks, a table for the rays and for every group, as the tables of residuals."""

    name: str
    masks: tuple[Mask, ...]

    @property
    def count(self) -> int:
        """Number of observations."""
        return int(sum(mask.sum() for mask in self.masks))

    def __and__(self, other: "Subset") -> "Subset":
        masks = tuple(a & b for a, b in zip(self.masks, other.masks, strict=True))
        return Subset(f"{self.name}, {other.name}", masks)

    def __or__(self, other: "Subset") -> "Subset":
        masks = tuple(a | b for a, b in zip(self.masks, other.masks, strict=True))
        return Subset(f"{self.name} and {other.name}", masks)

    def named(self, name: str) -> "Subset":
        """The same observations under another name."""
        return dataclasses.replace(self, name=name)


def all_observations(block: Block, name: str = "all observations") -> Subset:
    """Everything observed."""
    rays = np.ones((len(block.structure.ray_image), block.structure.model.components), bool)
    return Subset(name, (rays, *(group.structure.observed for group in block.groups)))


def image_coordinates(block: Block) -> Subset:
    """Both coordinates of every ray."""
    return _rays(block, "image coordinates", np.ones(len(block.structure.ray_image), bool))


def control_rays(block: Block) -> Subset:
    """Group I of the text 001: image coordinates of control points, those with a held or an observed coordinate."""
    require_a(Block, block, "statistics.control_rays")
    return _rays(block, "rays of control points", is_control_point(block)[block.structure.ray_point])


def tie_rays(block: Block) -> Subset:
    """Group II of the text 001: image coordinates of all other points."""
    require_a(Block, block, "statistics.tie_rays")
    return _rays(block, "rays of tie points", ~is_control_point(block)[block.structure.ray_point])


def camera_rays(block: Block, camera: str) -> Subset:
    """Image coordinates measured on the images of one camera.

    Raises: ValueError for an unknown name, as all that take names.
    """
    require_a(Block, block, "statistics.camera_rays")
    names = tuple(camera.name for camera in block.structure.cameras)
    (number,) = _numbers("camera", names, [camera])
    return _rays(block, f"rays of camera {camera}", block.structure.image_camera[block.structure.ray_image] == number)


def image_rays(block: Block, images: Collection[str], name: str) -> Subset:
    """Image coordinates measured on some images, as those of a strip; `name` is the strip's."""
    require_a(Block, block, "statistics.image_rays")
    numbers = _numbers("image", block.structure.image_names, images)
    return _rays(block, name, np.isin(block.structure.ray_image, numbers))


def observations_of_kind(block: Block, kind: str, components: Collection[str] | None = None) -> Subset:
    """All observations of a kind by its name, or some components, such as XY or Z of "control".

    "stations" are observed projection centres without systematic errors, "gnss_stations" those with such errors.

    Raises: ValueError for a kind or a component that the block does not have.
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
    """The observed coordinates of one control point."""
    require_a(Block, block, "statistics.control_point")
    (number,) = _numbers("point", block.structure.point_names, [point])

    def chosen(group: ObservationGroup) -> Mask:
        own = (group.structure.indices[:, :1] == number) & _is_coordinates(group)
        return group.structure.observed & own

    subset = _members(block, f"control point {point}", chosen)
    if subset.count == 0:
        raise ValueError(f"point {point} has no observed coordinates; to judge those that are held give them a sigma")
    return subset


def observed_points(block: Block) -> tuple[str, ...]:
    """Names of the points with an observed coordinate, in the order of the block."""
    return tuple(block.structure.point_names[p] for p in np.flatnonzero(_is_observed(block)))


def all_control(block: Block) -> Subset:
    """Group III of the text 001: everything observed that is no image coordinate."""
    require_a(Block, block, "statistics.all_control")
    return _members(block, "all control", lambda group: group.structure.observed)


def three_groups(block: Block) -> tuple[Subset, ...]:
    """Groups I and II of the text 001 and, in place of group III, one subset a kind of observation."""
    require_a(Block, block, "statistics.three_groups")
    kinds = dict.fromkeys(group.structure.kind.name for group in block.groups)
    subsets = control_rays(block), tie_rays(block), *(observations_of_kind(block, kind) for kind in kinds)
    return tuple(subset for subset in subsets if subset.count)


def require_whole_members(block: Block, subset: Subset) -> None:
    """Raises ValueError where a subset takes some of the correlated components of a member: they have no own weight."""
    for group, mask in zip(block.groups, subset.masks[1:], strict=True):
        observed = group.structure.observed
        split = mask.any(1) & (mask != observed).any(1)
        if group.covariances is not None and split.any():
            raise ValueError(
                f"{subset.name} takes some of the components of {group.structure.kind.name}, which are correlated with"
                " the others: take whole rows of the table, or give sigmas in place of covariances"
            )


def is_control_point(block: Block) -> Bool[np.ndarray, " point"]:
    """Points with a held coordinate, or one that is observed in the object system."""
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
