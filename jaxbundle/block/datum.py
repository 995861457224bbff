"""The datum of a block: by control and observed stations, by elements that the user holds, minimal, or by inner
constraints, a free network."""

import dataclasses

import numpy as np

from jaxbundle.block.block import Block, Datum
from jaxbundle.block.datum_defect import datum_defect, insufficient
from jaxbundle.block.problems import BlockError, Problem


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
    of another image which differs most from the first one's. A free network is adjusted in it too; its inner
    constraints are brought in afterwards by an S-transformation.

    Raises: BlockError where control exists but leaves a part of the datum undetermined.
    """
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
        return _with_structure(block, datum=Datum(kind, structure.datum.held))
    if is_located(block):
        raise BlockError([insufficient(defect)])
    free = structure.exterior_free.copy()
    first = structure.image_names[0]
    free[0] = False
    held = [(first, element) for element in structure.exterior_elements]
    if defect.count == 7:
        centres = np.asarray(block.exterior.projection_centre)
        image, k = np.unravel_index(np.argmax(np.abs(centres - centres[0])), centres.shape)
        free[image, k] = False
        held.append((structure.image_names[image], structure.exterior_elements[k]))
    if structure.datum.kind == "inner":
        datum = dataclasses.replace(structure.datum, held=tuple(held), constraints=len(held))
    else:
        datum = Datum("minimal", tuple(held))
    return _with_structure(block, datum=datum, exterior_free=free)


def inner_needs_none() -> Problem:
    """The problem of inner constraints where the datum is defined otherwise."""
    return Problem(
        "the inner constraints of a free network and control, observed stations or held elements exclude each other",
        'make the control points check points, or drop type = "inner" of [datum]',
        "control",
    )


def _with_structure(block: Block, **changes: object) -> Block:
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, **changes))
