"""Causes of an adjustment that did not converge, or that ended with unusable residuals.

A gross error of control bends and rotates a block until nothing fits, so the final residuals are not conclusive.
Therefore control is first observed with such large sigmas that the rays determine the shape of the block. It is
reweighted by its residuals until the consistent points determine the datum (an estimate of least sums, Krarup, Juhl,
Kubik 1980). Points that are then far off are left out, and the original block is adjusted again. If it converges, these
points are named, with the size of their errors.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.changes import without_component
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.block.wording import counted, named
from jaxbundle.diagnosis.exchanged_control import exchanged_control
from jaxbundle.diagnosis.observed_control import (
    LEAST,
    LOOSE,
    ObservedControl,
    as_observed,
    depth,
    started_where_rays_meet,
    tried,
)
from jaxbundle.diagnosis.wrong_rays import wrong_rays
from jaxbundle.numerics.host import tree_with
from jaxbundle.solve.adjustment import Adjustment, Status

ABSURD = 10.0  # sigma0 above which residuals are unusable
CURED = 0.3  # maximum share of sigma0 that remains without the named points
ROUNDS = 4  # rounds of reweighting: residuals of wrong points grow to their errors
OUTLYING = 6.0  # times the median distance of the others
SIDE_EFFECT = 0.05  # share of the maximum error: below this a point may be displaced by other errors
NO_WEIGHT = 1e9  # sigma in the object unit, of a point that is practically not observed
EXTREME = 1e-4  # share of the median sigma: the weight is 10^8 times that of the others


def causes(start: Block, adjustment: Adjustment) -> tuple[Finding, ...]:
    """Causes of a failed convergence, as findings.

    They are extreme weights, control points that contradict the others, or else rays and images.

    `start`: the block before the adjustment. No cause is searched for after a successful adjustment.
    """
    ended_well = adjustment.status is Status.CONVERGED and float(adjustment.sigma0) <= ABSURD
    if ended_well or not start.structure.model.photographs or adjustment.status is Status.INTERRUPTED:
        return ()
    with np.errstate(all="ignore"):
        found = (*_extreme_sigmas(start), *_wrong_control(start, adjustment))
        return found or exchanged_control(start) or wrong_rays(start, adjustment)


def _extreme_sigmas(block: Block) -> list[Finding]:
    """Findings about observations whose sigmas are far below those of their table."""
    s = block.structure
    findings = []
    sigmas = np.asarray(block.rays.sigmas).min(1)
    few = np.flatnonzero(sigmas < EXTREME * np.median(sigmas)) if len(sigmas) else np.zeros(0, int)
    if len(few):
        names = [(s.image_names[s.ray_image[k]], s.point_names[s.ray_point[k]]) for k in few]
        what = (
            f"{counted(len(few), 'ray')} with a sigma of {sigmas[few].min():.3g} against {np.median(sigmas):.3g} of the"
            f" others: {named([f'point {point} on image {image}' for image, point in names])}"
        )
        subjects = tuple(Subject("rays", name) for name in names)
        findings.append(
            Finding(Kind.SIGMAS, what, "correct the sigma, and its unit", subjects, float(sigmas[few].min()))
        )
    for group in block.groups:
        if group.structure.kind == CONTROL and group.covariances is None:
            findings += _extreme_control(
                block, group.structure.indices[:, 0], np.asarray(group.sigmas), group.structure.observed
            )
    return findings


def _extreme_control(
    block: Block,
    point: Int[np.ndarray, " member"],
    sigmas: Float[np.ndarray, "member 3"],
    observed: Bool[np.ndarray, "member 3"],
) -> list[Finding]:
    if not observed.any():
        return []
    typical = np.median(sigmas[observed])
    few = np.flatnonzero((observed & (sigmas < EXTREME * typical)).any(1))
    if not len(few):
        return []
    names = [block.structure.point_names[point[k]] for k in few]
    least, unit = np.where(observed, sigmas, np.inf)[few].min(), block.structure.object_unit
    what = (
        f"{counted(len(few), 'control point')} with a sigma of {least:.3g} {unit} against {typical:.3g} {unit} of the"
        f" others: {named(names)}"
    )
    cure = "correct the sigma, or fix the point with sigma 0"
    return [Finding(Kind.SIGMAS, what, cure, tuple(Subject("control", (name,)) for name in names), float(least), unit)]


def _wrong_control(start: Block, adjustment: Adjustment) -> list[Finding]:
    """Findings about control points without which the block converges."""
    control = as_observed(start)
    if control is None or len(control.point) < LEAST:
        return []
    wrong = _far_off(control)
    if wrong is None or not wrong.any() or 2 * wrong.sum() >= len(wrong):
        return []
    without = tried(_held_back(control, wrong))
    if without is None:
        return []
    error = np.linalg.norm(_errors(control, without), axis=1)
    large = wrong & (error > SIDE_EFFECT * error[wrong].max())
    if (large != wrong).any():  # correct points that the large errors displaced
        again = tried(_held_back(control, large))
        if again is not None and float(again.sigma0) <= ABSURD:
            wrong, without = large, again
    before, after = float(adjustment.sigma0), float(without.sigma0)
    if not (after <= ABSURD or after <= CURED * before):
        return []
    return [_named(start, control, wrong, without)]


def _far_off(control: ObservedControl) -> Bool[np.ndarray, " member"] | None:
    """Indices of control points that are far off when the others agree."""
    block, group = started_where_rays_meet(control.block), control.block.groups[control.group]
    observed, values = group.structure.observed, np.asarray(group.values)
    sigma = np.full(len(values), LOOSE * depth(block))
    factor = np.maximum(1.0, (_distances(block, control.point, values, observed) / sigma) ** 2)
    distance = np.zeros(len(values))
    for _ in range(ROUNDS):
        loose = np.where(observed, np.minimum(sigma * factor, NO_WEIGHT)[:, None], 1.0)
        block = tree_with(lambda b: b.groups[control.group].sigmas, block, loose)
        found = tried(block, converged=False)
        if found is None:
            return None
        block = found.block
        distance = _distances(block, control.point, values, observed)
        typical = max(float(np.median(distance)), float(np.finfo(float).tiny))
        factor = np.maximum(1.0, (distance / typical) ** 2)
    others = np.array([np.median(np.delete(distance, k)) for k in range(len(distance))])
    return distance > np.maximum(OUTLYING * others, sigma / OUTLYING)


def _distances(
    block: Block,
    point: Int[np.ndarray, " member"],
    values: Float[np.ndarray, "member 3"],
    observed: Bool[np.ndarray, "member 3"],
) -> Float[np.ndarray, " member"]:
    return np.linalg.norm(np.where(observed, np.asarray(block.object_points)[point] - values, 0.0), axis=1)


def _held_back(control: ObservedControl, wrong: Bool[np.ndarray, " member"]) -> Block:
    block = control.block
    block = started_where_rays_meet(block)
    for member in np.flatnonzero(wrong):
        for component in range(3):
            block = without_component(block, control.group, int(member), component)
    return block


def _errors(control: ObservedControl, found: Adjustment) -> Float[np.ndarray, "member 3"]:
    """Given - adjusted coordinates, 0 where not given."""
    group = control.block.groups[control.group]
    error = np.asarray(group.values) - np.asarray(found.block.object_points)[control.point]
    return np.where(group.structure.observed, error, 0.0)


def _named(start: Block, control: ObservedControl, wrong: Bool[np.ndarray, " member"], without: Adjustment) -> Finding:
    """The finding about the control points that were left out, with their errors."""
    s, members = start.structure, np.flatnonzero(wrong)
    error = _errors(control, without)[members]
    size = np.linalg.norm(error, axis=1)
    order = np.argsort(-size)
    names = [s.point_names[control.point[members[k]]] for k in order]
    parts = [
        f"{name} ({', '.join(f'{x:.4g}' for x in error[k])}) {s.object_unit}"
        for name, k in zip(names, order, strict=True)
    ]
    one = len(names) == 1
    what = (
        f"without {'control point' if one else 'control points'} {named(names)} the adjustment converges with sigma0"
        f" {float(without.sigma0):.4g}; errors of the given X, Y, Z: {named(parts)}"
    )
    cure = (
        f"check {'its' if one else 'their'} coordinates and name{'' if one else 's'}, or drop {'it' if one else 'them'}"
    )
    subjects = tuple(Subject("control", (name,)) for name in names)
    return Finding(Kind.SUSPECT, what, cure, subjects, float(size.max()), s.object_unit)
