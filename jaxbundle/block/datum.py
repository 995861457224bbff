"""The datum of a block: by control and observed stations, by elements that the user holds, minimal, or by inner
constraints, a free network."""

import dataclasses

import numpy as np
import scipy.linalg

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum_defect import DatumDefect, datum_defect, insufficient, sensitivity
from jaxbundle.block.derived import derived
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import BlockError, Problem

WEAK = 1e-3  # change of an element that hardly defines a direction, in units of the block's radius or in radians


def is_located(block: Block) -> bool:
    """Whether any coordinate of the object system is observed or held."""
    structure = block.structure
    return bool(
        (~structure.point_free).any()
        or structure.datum.held
        or any(group.structure.kind.in_object_system and group.count for group in block.groups)
    )


def with_datum(block: Block) -> Block:
    """The block with its datum defined: by control, as held by the user, or by a minimal set chosen here.

    The minimal datum holds all six elements of the first image and, unless a distance gives the scale, that coordinate
    of another image which differs most from the first one's; where observations give more, as plumb lines the vertical,
    those of these elements which define best what they leave open. A free network is adjusted in it too; its inner
    constraints are brought in afterwards by an S-transformation.

    Raises: BlockError where control exists but leaves a part of the datum undetermined.
    """
    require_a(Block, block, "blocks.with_datum")
    structure = block.structure
    if structure.datum.kind in ("control", "minimal") or (structure.datum.kind == "inner" and structure.datum.held):
        return block
    if not block.concrete:
        raise ValueError(
            "the datum is chosen before tracing: call block = jaxbundle.with_datum(block) outside of jit, grad and vmap"
        )
    defect = datum_defect(block)
    if structure.datum.kind == "inner" and (defect.count == 0 or is_located(block)):
        raise BlockError([inner_needs_none()])
    if defect.count == 0:
        kind = structure.datum.kind if structure.datum.held else "control"
        return _with_structure(block, datum=Datum(kind, structure.datum.held, carriers=_carriers(block)))
    if is_located(block):
        raise BlockError([insufficient(defect)])
    chosen = _minimal(block)
    if structure.datum.kind == "inner":
        _require_inner(defect, len(chosen))
    free = structure.exterior_free.copy()
    held = []
    for image, k in chosen:
        free[image, k] = False
        held.append((structure.image_names[image], structure.exterior_elements[k]))
    if structure.datum.kind == "inner":
        datum = dataclasses.replace(structure.datum, held=tuple(held), constraints=len(held))
    else:
        datum = Datum("minimal", tuple(held))
    return _with_structure(block, datum=datum, exterior_free=free)


def _carriers(block: Block) -> tuple[str, ...]:
    """What is observed or held in the object system."""
    words = {"point": "control points", "image": "observed stations"}
    kinds = [group.structure.kind for group in block.groups if group.structure.kind.in_object_system and group.count]
    held = ["control points"] if (~block.structure.point_free).any() else []
    return tuple(dict.fromkeys([*held, *(words.get(kind.touches[0], kind.name) for kind in kinds)]))


def _minimal(block: Block) -> list[tuple[int, int]]:
    """Image and element of those that define what is open, as many as that is."""
    centres = np.asarray(block.exterior.projection_centre)
    other, axis = (int(k) for k in np.unravel_index(np.argmax(np.abs(centres - centres[0])), centres.shape))
    elements = [*((0, k) for k in range(6)), (other, axis)]
    moved = sensitivity(block, elements) if block.groups else np.eye(len(elements))
    count = moved.shape[1]
    if count == len(elements):
        return elements
    # rows are chosen one after the other, each with the largest part at right angles to those before it
    *_, order = scipy.linalg.qr(moved[:6].T, pivoting=True, mode="economic")
    if np.linalg.svd(moved[:6], compute_uv=False)[count - 1] < WEAK:
        *_, order = scipy.linalg.qr(moved.T, pivoting=True, mode="economic")
    return [elements[k] for k in sorted(order[:count].tolist())]


def _require_inner(defect: DatumDefect, count: int) -> None:
    """Raises BlockError where observations leave less open than origin and axes, or parameters move with them."""
    cure = 'leave out the observations that do so, or give type = "minimal" in [datum]'
    if count < 6 or (count == 6 and defect.scale):
        what = f"a free network needs origin and axes to be open, and the observations leave {defect.words}"
    elif defect.parameters:
        what = (
            f"origin and axes of a free network are open, and {', '.join(defect.parameters[:3])} would move with them"
        )
    else:
        return
    raise BlockError([Problem(what, cure, "datum")])


def inner_needs_none() -> Problem:
    """The problem of inner constraints where the datum is defined otherwise."""
    return Problem(
        "the inner constraints of a free network and control, observed stations or held elements exclude each other",
        'make the control points check points, or drop type = "inner" of [datum]',
        "control",
    )


def _with_structure(block: Block, **changes: object) -> Block:
    return dataclasses.replace(block, structure=derived(block.structure, **changes))
