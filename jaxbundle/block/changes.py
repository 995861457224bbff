"""Changes of the unknowns and of the observations of a block."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, in_order
from jaxbundle.block.given import require_a
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.numerics.host import on_host_or_traced, selected, tree_with


def with_findings(block: Block, findings: Iterable[Finding]) -> Block:
    """The block with additional findings."""
    structure = block.structure
    return dataclasses.replace(
        block, structure=dataclasses.replace(structure, findings=in_order([*structure.findings, *findings]))
    )


def with_interior_held(block: Block) -> Block:
    """The block with all interior elements fixed at their values.

    Example:
        >>> bool(jb.blocks.with_interior_held(block).structure.interior_free.any())
        False
    """
    require_a(Block, block, "blocks.with_interior_held")
    structure = dataclasses.replace(block.structure, interior_free=np.zeros_like(block.structure.interior_free))
    return dataclasses.replace(block, structure=structure)


def with_sigmas_multiplied(block: Block, factors: Sequence[Float[np.ndarray, "_member _component"]]) -> Block:
    """The block with the sigmas of rays and of each group multiplied by factors, of components or whole members.

    All observed components of a member with covariances have the same factor, and those are multiplied by its square.
    """
    groups = range(len(block.groups))
    correlated = [k for k in groups if block.groups[k].covariances is not None]

    def values(block: Block) -> list[Any]:
        sigmas = [block.groups[k].sigmas for k in groups]
        return [block.rays.sigmas, *sigmas, *(block.groups[k].covariances for k in correlated)]

    of_members = [np.where(block.groups[k].structure.observed, factors[1 + k], 0.0).max(1) for k in correlated]
    squares = [np.where(f > 0, f, 1.0)[:, None, None] ** 2 for f in of_members]
    return eqx.tree_at(values, block, _products(values(block), [*factors, *squares]))


@on_host_or_traced
def _products(_xp: Any, values: list, factors: list) -> list:
    return [value * factor for value, factor in zip(values, factors, strict=True)]


def with_unknowns_of(block: Block, other: Block) -> Block:
    """The observations and fixed coordinates of a block with the unknowns of another one of the same structure."""
    points = np.where(block.structure.point_free, np.asarray(other.object_points), np.asarray(block.object_points))
    return tree_with(
        lambda b: (b.exterior, b.interior, b.parameters, b.object_points),
        block,
        (other.exterior, other.interior, other.parameters, points),
    )


def without_ray(block: Block, ray: int) -> Block:
    """The block without a ray; a point with only one remaining ray and no other observation is removed too."""
    structure = block.structure
    point = structure.ray_point[ray]
    keep = np.ones(len(structure.ray_image), bool)
    keep[ray] = False
    others = np.flatnonzero(keep & (structure.ray_point == point))
    lonely = len(others) == 1 and structure.point_free[point].any() and not _is_touched(block, int(point))
    if lonely:
        keep[others] = False
    structure = dataclasses.replace(structure, ray_image=structure.ray_image[keep], ray_point=structure.ray_point[keep])
    block = dataclasses.replace(block, structure=structure, rays=selected(block.rays, keep))
    return _without_point(block, int(point)) if lonely else block


def _is_touched(block: Block, point: int) -> bool:
    """Whether an observation other than a ray refers to the point."""
    return any(
        (group.structure.indices[:, k] == point).any()
        for group in block.groups
        for k, kind in enumerate(group.structure.kind.touches)
        if kind == "point"
    )


def _without_point(block: Block, point: int) -> Block:
    """The block without a point that has no observations."""
    s = block.structure
    keep = np.arange(len(s.point_names)) != point
    number = np.cumsum(keep) - 1
    known = s.check_point != point
    structure = dataclasses.replace(
        s,
        point_names=tuple(name for name, kept in zip(s.point_names, keep, strict=True) if kept),
        ray_point=number[s.ray_point].astype(s.ray_point.dtype),
        point_free=s.point_free[keep],
        check_point=number[s.check_point[known]].astype(s.check_point.dtype),
    )

    def renumbered(group: ObservationGroup) -> ObservationGroup:
        indices = group.structure.indices.copy()
        for k, kind in enumerate(group.structure.kind.touches):
            if kind == "point":
                indices[:, k] = number[indices[:, k]]
        return dataclasses.replace(group, structure=dataclasses.replace(group.structure, indices=indices))

    return dataclasses.replace(
        block,
        structure=structure,
        object_points=selected(block.object_points, keep),
        groups=tuple(map(renumbered, block.groups)),
        check_points=selected(block.check_points, known),
    )


def without_component(block: Block, group: int, member: int, component: int) -> Block:
    """The block in which one component of one member of a group is not observed."""
    old = block.groups[group]
    observed = old.structure.observed.copy()
    observed[member, component] = False
    new = dataclasses.replace(old, structure=dataclasses.replace(old.structure, observed=observed))
    return dataclasses.replace(block, groups=(*block.groups[:group], new, *block.groups[group + 1 :]))
