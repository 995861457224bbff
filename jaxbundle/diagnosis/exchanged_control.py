"""Finding exchanged names of control points, if their number is too small to leave the wrong ones out.

The rays alone determine the shape of the block. A similarity transformation fits it to the control for each assignment
of the names; if one assignment fits and all others are far worse, the names are exchanged. Four points have 5 redundant
coordinates (12 minus the 7 of the similarity).
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.wording import named
from jaxbundle.diagnosis.observed_control import (
    LEAST,
    ObservedControl,
    as_observed,
    started_where_rays_meet,
    tried,
)
from jaxbundle.geometry.similarity import similarity
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import tree_with

ALL_ORDERS = 5  # points: all 120 orders of their names are tried; with more points only those that exchange two names
MAX_POINTS = 60  # maximum number of points, with 1770 pairs
CLEARLY = 5.0  # minimum ratio of the misfits of each other order and the best one


def exchanged_control(start: Block) -> tuple[Finding, ...]:
    """The finding about exchanged names with which the control fits the shape from the rays; empty without one.

    `start`: the block before the adjustment, with orientations that agree with its rays.
    """
    control = as_observed(start)
    if control is None or not LEAST <= len(control.point) <= MAX_POINTS:
        return ()
    group = control.block.groups[control.group]
    if not group.structure.observed.all():
        return ()
    shape = _shape(control)
    if shape is None:
        return ()
    orders = _orders(len(control.point))
    misfit = np.asarray(_misfits(shape, np.asarray(group.values)[orders], optimised=False))
    best = int(np.argmin(misfit))
    others = np.delete(misfit, best)
    if best == 0 or others.min() < CLEARLY * misfit[best]:
        return ()
    if tried(_with_order(control, orders[best])) is None:
        return ()
    return (_named(start, control, orders[best], float(misfit[0])),)


def _shape(control: ObservedControl) -> Float[np.ndarray, "member 3"] | None:
    """Coordinates of the control points from an adjustment without control."""
    groups = tuple(group for k, group in enumerate(control.block.groups) if k != control.group)
    found = tried(with_datum(started_where_rays_meet(dataclasses.replace(control.block, groups=groups))))
    return None if found is None else np.asarray(found.block.object_points)[control.point]


def _orders(count: int) -> Int[np.ndarray, "order member"]:
    """Orders of the names to try; the given one is the first."""
    if count <= ALL_ORDERS:
        return np.array(list(itertools.permutations(range(count))))
    given = np.arange(count)
    orders = [given]
    for pair in itertools.combinations(range(count), 2):
        order = given.copy()
        order[list(pair)] = order[list(reversed(pair))]
        orders.append(order)
    return np.array(orders)


@Compiled
def _misfits(shape: Float[Array, "member 3"], values: Float[Array, "order member 3"]) -> Float[Array, " order"]:
    """Root mean square distance of the control from the transformed shape, for each order."""

    def misfit(values: Float[Array, "member 3"]) -> Float[Array, ""]:
        fit = similarity(shape, values, jnp.ones(len(shape))).similarity
        return jnp.sqrt(jnp.mean(jnp.sum((fit(shape) - values) ** 2, 1)))

    return jax.vmap(misfit)(values)


def _with_order(control: ObservedControl, order: Int[np.ndarray, " member"]) -> Block:
    """The block with the coordinates of its control points in another order."""
    values = np.asarray(control.block.groups[control.group].values)[order]
    block = tree_with(lambda b: b.groups[control.group].values, control.block, values)
    return started_where_rays_meet(block)


def _named(start: Block, control: ObservedControl, order: Int[np.ndarray, " member"], misfit: float) -> Finding:
    """The finding about points with the coordinates of others."""
    names, unit = start.structure.point_names, start.structure.object_unit
    exchanged = np.flatnonzero(order != np.arange(len(order)))
    pairs = sorted((names[control.point[order[k]]], names[control.point[k]]) for k in exchanged)
    one = [first for first, _ in pairs]
    what = f"the names or coordinates of control points {named(one)} are exchanged"
    if len(pairs) > 2:
        what += ": " + named([f"the coordinates given for {first} belong to {right}" for first, right in pairs])
    what += f"; with the given names, the shape of the block differs from the control by {misfit:.4g} {unit}"
    subjects = tuple(Subject("control", (name,)) for name in one)
    return Finding(Kind.SUSPECT, what, "exchange them back", subjects, misfit, unit)
