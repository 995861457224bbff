"""The datum of a block: control and stations, fixed elements, minimal, or inner constraints."""

import dataclasses

import numpy as np
import scipy.linalg

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum_defect import DatumDefect, datum_defect, insufficient, sensitivity
from jaxbundle.block.derived import derived
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import BlockError, Problem

WEAK = 1e-3  # minimum change of an element that defines a direction, in units of the block's radius or in radians


def is_located(block: Block) -> bool:
    """Whether any coordinate of the object system is observed or fixed."""
    structure = block.structure
    return bool(
        (~structure.point_free).any()
        or structure.datum.held
        or any(group.structure.kind.in_object_system and group.count for group in block.groups)
    )


def with_datum(block: Block) -> Block:
    """Returns the block with a defined datum: by control, by elements that the user fixes, or by a minimal set.

    The minimal datum fixes all six elements of the first image. Unless a distance determines the scale, it also fixes
    the coordinate of another image that differs most from the first one's. If observations determine more, such as
    plumb lines the vertical, only those of these elements are fixed that best define the undetermined rest. A free
    network is first adjusted in the minimal datum; the result is transformed to inner constraints by an
    S-transformation.

    Raises: BlockError where control exists but leaves a part of the datum undetermined.

    Example:
        >>> jb.blocks.with_datum(block).structure.datum.kind
        'control'
    """
    require_a(Block, block, "blocks.with_datum")
    structure = block.structure
    if structure.datum.kind in ("control", "minimal") or (structure.datum.kind == "inner" and structure.datum.held):
        return block
    if not block.concrete:
        raise ValueError(
            "the datum is chosen before tracing: call block = jb.blocks.with_datum(block) outside jit, grad and vmap"
        )
    defect = datum_defect(block)
    if structure.datum.kind == "inner" and (defect.count == 0 or is_located(block)):
        raise BlockError([inner_needs_none()])
    if defect.count == 0:
        kind = structure.datum.kind if structure.datum.held else "control"
        return _with_structure(block, datum=Datum(kind, structure.datum.held, carriers=_carriers(block)))
    if is_located(block):
        raise BlockError([insufficient(defect)])
    chosen = _minimal(block, defect)
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
    """Words for the objects that are observed or fixed in the object system."""
    words = {"point": "control points", "image": "observed stations"}
    kinds = [group.structure.kind for group in block.groups if group.structure.kind.in_object_system and group.count]
    held = ["control points"] if (~block.structure.point_free).any() else []
    return tuple(dict.fromkeys([*held, *(words.get(kind.touches[0], kind.name) for kind in kinds)]))


def _minimal(block: Block, defect: DatumDefect) -> list[tuple[int, int]]:
    """Image and element of the elements that define the undetermined directions, one element for each direction."""
    centres = np.asarray(block.exterior.projection_centre)
    other, axis = (int(k) for k in np.unravel_index(np.argmax(np.abs(centres - centres[0])), centres.shape))
    elements = [*((0, k) for k in range(6)), (other, axis)]
    moved = sensitivity(block, defect, elements) if block.groups else np.eye(len(elements))
    count = moved.shape[1]
    if count == len(elements):
        return elements
    # rows are chosen one after the other, each with the maximum component orthogonal to the rows before it
    *_, order = scipy.linalg.qr(moved[:6].T, pivoting=True, mode="economic")
    if np.linalg.svd(moved[:6], compute_uv=False)[count - 1] < WEAK:
        *_, order = scipy.linalg.qr(moved.T, pivoting=True, mode="economic")
    return [elements[k] for k in sorted(order[:count].tolist())]


def _require_inner(defect: DatumDefect, count: int) -> None:
    """Raises BlockError if observations determine a part of origin and axes, or if parameters change with them."""
    cure = 'leave out these observations, or give type = "minimal" in [datum]'
    if count < 6 or (count == 6 and defect.scale):
        what = (
            f"a free network requires that no observation determines origin and axes; undetermined here: {defect.words}"
        )
    elif defect.parameters:
        what = f"the axes of a free network are undetermined, and {', '.join(defect.parameters[:3])} change with them"
    else:
        return
    raise BlockError([Problem(what, cure, "datum")])


def inner_needs_none() -> Problem:
    """The problem of inner constraints if the datum is also defined otherwise."""
    return Problem(
        "the inner constraints of a free network and control, observed stations or fixed elements exclude each other",
        'make the control points check points, or drop type = "inner" of [datum]',
        "control",
    )


def _with_structure(block: Block, **changes: object) -> Block:
    return dataclasses.replace(block, structure=derived(block.structure, **changes))
