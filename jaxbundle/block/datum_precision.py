"""Precision of the datum from control, observed stations and distances: covariance of the seven parameters.

Rays do not depend on a similarity transformation of the whole block, so its precision follows only from the
other observations, from the rows A of the datum defect with their weights P:

    Q = (A^T P A)^-1        of (t, r, m) and the block's parameters, with fixed coordinates as constraints

It needs no normal equations of the block, and is available without standard deviations of the unknowns.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.datum_defect import datum_equations
from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.observed_places import Frame, observed_places
from jaxbundle.block.similarity_defect import SimilarityDefect, displacements, similarity_defect
from jaxbundle.block.wording import named

# standard deviation of a rotation: above this, error propagation of first order is wrong by 1.5 %
MAX_ANGLE = np.deg2rad(10.0)
# standard deviation of a position in the block as a share of its radius: above this no map is possible
MAX_SHARE = 0.1
AT_REST = 0.05  # share of the maximum displacement: positions on the axis of a rotation


class DatumPrecision(NamedTuple):
    """Covariance of (t, r, m), t in units of the radius; for the a-priori sigmas."""

    covariance: Float[np.ndarray, "7 7"]
    frame: Frame


def datum_precision(block: Block) -> DatumPrecision | None:
    """Precision of the datum of a block; None where it has a defect, or consists only of fixed elements."""
    equations = datum_equations(block)
    if not equations.weighted.size:
        return None
    free = equations.free
    columns = np.eye(len(free))[:, free]
    held = equations.fixed @ columns
    if held.size:
        _, size, vt = np.linalg.svd(np.concatenate([held, np.zeros((held.shape[1],) * 2)]), full_matrices=False)
        columns = columns @ vt[size <= 1e-8 * max(size.max(initial=0.0), 1.0)].T
    rows = equations.weighted @ columns
    if not columns.shape[1] or not np.isfinite(rows).all():
        return None
    lengths = np.linalg.norm(rows, axis=0)
    if not (lengths > 0).all():
        return None
    _, size, vt = np.linalg.svd(rows / lengths, full_matrices=False)
    if len(size) < columns.shape[1] or size.min() <= 1e-12 * size.max():
        return None
    root = (columns @ (vt / lengths).T / size)[:7]
    return DatumPrecision(root @ root.T, equations.frame)


def weak_datum(block: Block, sigma0: float) -> tuple[Finding, ...]:
    """A finding if the weakest direction of the datum has no usable standard deviation.

    `sigma0` does not enlarge the sigmas: large residuals have other causes and other findings.
    """
    if block.structure.datum.kind != "control":
        return ()
    precision = datum_precision(block)
    if precision is None:
        return ()
    factor = min(sigma0, 1.0) if np.isfinite(sigma0) else 1.0
    frame, points = precision.frame, precision.frame.points
    points = points[np.isfinite(points).all(1)]
    extent = float(np.median(np.linalg.norm(points - np.median(points, 0), axis=1)))
    values, vectors = np.linalg.eigh(factor**2 * precision.covariance)
    directions = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, ::-1]  # the weakest first
    moves = displacements(directions, points, frame.radius)
    for direction, move in zip(directions.T, moves, strict=True):
        angle, inside = float(np.linalg.norm(direction[3:6])), np.linalg.norm(move - np.median(move, axis=0), axis=1)
        if angle > MAX_ANGLE or np.median(inside) > MAX_SHARE * extent:
            moved = float(np.linalg.norm(move, axis=1).max())
            return (_finding(block, frame, direction[:, None], (moved, angle), Severity.FAILED),)
    whole = np.linalg.norm(moves[0], axis=1)
    if np.median(whole) <= MAX_SHARE * extent:
        return ()
    # a translation of the whole block leaves its shape and its attitude as precise as they are
    angle = float(np.linalg.norm(directions[3:6, 0]))
    return (_finding(block, frame, directions[:, :1], (float(whole.max()), angle), Severity.CHECK),)


def _finding(
    block: Block, frame: Frame, worst: Float[np.ndarray, "7 1"], size: tuple[float, float], severity: Severity
) -> Finding:
    """The weakest direction in words, as the dominating part of a similarity transformation.

    `size`: the maximum displacement, and the angle.
    """
    unit, (moved, angle) = block.structure.object_unit, size
    places = observed_places(block, frame)
    distances = np.linalg.norm(displacements(worst, np.array([p for *_, p in places]), frame.radius)[0], axis=1)
    resting = [places[k] for k in np.flatnonzero(distances <= AT_REST * moved)]
    what, turns = similarity_words(worst)
    if turns and len(resting) > 1:
        what = f"the rotation about the line through {named([name for _, name, _ in resting])}"
    sized = f"{np.rad2deg(angle):.3g} deg" if turns else f"{moved:.3g} {unit}"
    what = (
        f"control and observed stations determine {what} with a standard deviation of {sized} only:"
        f" points are uncertain by up to {moved:.3g} {unit}"
    )
    cure = "add control, or observed stations, away from the line of the existing ones"
    subjects = tuple(Subject("control" if table == "point" else "stations", (name,)) for table, name, _ in resting)
    return Finding(Kind.IMPRECISE, what, cure, subjects, moved, unit, severity)


def similarity_words(direction: Float[np.ndarray, "7 1"]) -> tuple[str, bool]:
    """The dominating parameter of a direction, and whether it is a rotation."""
    # a rotation or a change of scale about a position off the centre also shifts the centre
    shares = [1e-3 * np.linalg.norm(direction[:3]), np.linalg.norm(direction[3:6]), abs(float(direction[6, 0]))]
    kind, unit = int(np.argmax(shares)), np.zeros(7)
    rows = (slice(0, 3), slice(3, 6), slice(6, 7))[kind]
    unit[rows] = direction[rows, 0] / shares[kind]
    found: SimilarityDefect = similarity_defect(unit[:, None])
    return found.words, kind == 1
