"""The control of a block as one group of observations, for trials that change or leave out control points."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import CONTROL, observation_group
from jaxbundle.block.problems import BlockError
from jaxbundle.numerics.host import tree_with
from jaxbundle.orientation.sight import intersected, photo_vectors, sight_of
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status

LOOSE = 0.02  # share of the depth: sigma of loose control; flight plans and models are better
FAR = 0.3  # share of the depth: beyond, control starts at the intersection of its rays
ITERATIONS = 50  # maximum number for one trial
LEAST = 4  # minimum number of control points; with three, no point can be identified as wrong


class ObservedControl(NamedTuple):
    """A block with the control in one group; the index of this group and its points."""

    block: Block
    group: int
    point: Int[np.ndarray, " member"]


def as_observed(block: Block) -> ObservedControl | None:
    """The block in which fixed control points are observed, in the same group as the others."""
    groups = [
        k for k, group in enumerate(block.groups) if group.structure.kind == CONTROL and group.covariances is None
    ]
    free = block.structure.point_free
    held = np.flatnonzero(~free.all(1))
    if len(groups) > 1 or (not groups and not len(held)):
        return None
    if not len(held):
        return ObservedControl(block, groups[0], block.groups[groups[0]].structure.indices[:, 0])
    values = np.full((len(free), 3), np.nan)
    sigmas = np.full((len(free), 3), np.nan)
    if groups:
        group = block.groups[groups[0]]
        point, observed = group.structure.indices[:, 0], group.structure.observed
        values[point] = np.where(observed, np.asarray(group.values), np.nan)
        sigmas[point] = np.where(observed, np.asarray(group.sigmas), np.nan)
    typical = np.nanmedian(sigmas) if np.isfinite(sigmas).any() else LOOSE * LOOSE * depth(block)
    values, sigmas = np.where(free, values, np.asarray(block.object_points)), np.where(free, sigmas, typical)
    chosen = np.flatnonzero(np.isfinite(values).any(1))
    new = observation_group(CONTROL, chosen[:, None], values[chosen], sigmas[chosen])
    others = tuple(group for k, group in enumerate(block.groups) if k not in groups)
    structure = dataclasses.replace(block.structure, point_free=np.ones_like(free))
    return ObservedControl(dataclasses.replace(block, structure=structure, groups=(*others, new)), len(others), chosen)


def depth(block: Block) -> float:
    sight = sight_of(block)
    return float(np.median(np.abs(photo_vectors(sight, sight.points)[:, 2])))


def started_where_rays_meet(block: Block) -> Block:
    """The block in which control points with a distant start are at the intersection of their rays."""
    sight = sight_of(block)
    meet = intersected(sight)
    far = np.linalg.norm(meet.points - sight.points, axis=1) > FAR * depth(block)
    moved = sight.is_known & meet.in_front & far
    return tree_with(lambda b: b.object_points, block, np.where(moved[:, None], meet.points, sight.points))


def tried(block: Block, converged: bool = True) -> Adjustment | None:
    """The adjustment; None if it is impossible or, if required, does not converge."""
    try:
        found = adjust(block, precision=False, max_iterations=ITERATIONS)
    except BlockError:
        return None
    usable = found.status is Status.CONVERGED or (not converged and found.status is Status.MAXIMUM_ITERATIONS)
    return found if usable and np.isfinite(float(found.sigma0)) else None
