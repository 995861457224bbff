"""Transforming a block with an arbitrary object system into the system of its control or observed stations.

X = s R x + T        the best fitting similarity of all control points with three coordinates, else of the stations
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block, ExteriorOrientation
from jaxbundle.block.changes import with_findings
from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.geometry.similarity import Similarity, similarity
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import ForeignBlock, Known
from jaxbundle.numerics.host import on_device, on_host, tree_with

LEAST = 3  # points that determine a similarity
FLAT = 1e-6  # ratio of singular values: below this the points lie on a line
SAME = 0.2  # share of the extent of the known points: systems that differ by less are the same up to measuring errors


def in_control_system(block: Block, foreign: ForeignBlock) -> Block:
    """The block in the system of control or stations, if at least three known points do not lie on one line.

    A block whose object system is meaningful is transformed only where its control has another position.
    """
    s = block.structure
    places = {name: k for k, name in enumerate(s.point_names)}, {name: k for k, name in enumerate(s.image_names)}
    coordinates = on_host(block.object_points), on_host(block.exterior.projection_centre)
    for what, rows, position, own in zip(
        ("control points", "stations"), (foreign.control, foreign.stations), places, coordinates, strict=True
    ):
        model, known = _pairs(rows, position, own)
        if len(model) < LEAST:
            continue
        extent = float(np.linalg.norm(np.ptp(known, axis=0)))
        if not foreign.arbitrary and _rms(model - known) < SAME * extent:
            return block
        found = similarity(
            on_device(model - model.mean(0)), on_device(known - known.mean(0)), on_device(np.ones(len(model)))
        )
        values = on_host(found.singular_values)
        if not values[1] > FLAT * values[0]:
            continue
        fit = _uncentred(found.similarity, model.mean(0), known.mean(0))
        left = _rms(on_host(fit(on_device(model))) - known)
        words = (
            f"the block was transformed into the system of {len(model)} {what}: scale {float(fit.scale):.6g}, misfit"
        )
        note = Finding(Kind.INFORMATION, f"{words} {left:.3g} {s.object_unit} rms", "", (), left, s.object_unit)
        return with_findings(_transformed(block, fit), [note])
    if foreign.arbitrary and foreign.control:
        what = f"no transformation into the system of the control: {LEAST} points with three coordinates are needed"
        return with_findings(block, [Finding(Kind.NOT_USED, what, "measure more of them", grade=Severity.FAILED)])
    return block


def _pairs(
    rows: tuple[Known, ...], position: dict[str, int], own: Float[np.ndarray, "entity 3"]
) -> tuple[Float[np.ndarray, "known 3"], Float[np.ndarray, "known 3"]]:
    """Coordinates in the block and known coordinates, where both are complete; check points are not used."""
    usable = [row for row in rows if not row.check]
    model = own[[position[row.name] for row in usable]].reshape(-1, 3)
    known = np.array([row.coordinates for row in usable], float).reshape(-1, 3)
    complete = np.isfinite(model).all(1) & np.isfinite(known).all(1)
    return model[complete], known[complete]


def _rms(differences: Float[np.ndarray, "known 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(differences**2, 1))))


def _uncentred(fit: Similarity, model: Float[np.ndarray, "3"], known: Float[np.ndarray, "3"]) -> Similarity:
    translation = on_host(fit.translation) + known - float(fit.scale) * on_host(fit.rotation) @ model
    return Similarity(fit.scale, fit.rotation, on_device(translation))


def _transformed(block: Block, fit: Similarity) -> Block:
    """Transforms projection centres, attitudes and points by a similarity."""
    turn = on_host(fit.rotation)
    matrices = turn @ rotations.from_angles(on_host(block.exterior.angles))
    exterior = ExteriorOrientation(fit(block.exterior.projection_centre), on_device(rotations.to_angles(matrices)))
    block = dataclasses.replace(block, exterior=exterior)
    return eqx.tree_at(lambda b: b.object_points, block, fit(block.object_points))


def at_control(block: Block, foreign: ForeignBlock) -> Block:
    """The block with fixed control coordinates at their given values."""
    held = ~block.structure.point_free
    if not held.any():
        return block
    points = np.array(on_host(block.object_points))
    position = {name: k for k, name in enumerate(block.structure.point_names)}
    for row in foreign.control:
        k = position[row.name]
        points[k] = np.where(held[k], row.coordinates, points[k])
    return tree_with(lambda b: b.object_points, block, points)
