"""Changed structures: the same change of the same structure returns the same object.

Compiled programs and plans are looked up by the identity of a structure. Therefore a change that each adjustment
repeats, such as the choice of a datum, must not create a new structure each time.
"""

import dataclasses
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from jaxbundle.block.block import Structure

REMEMBERED = 4  # maximum number of changes of one structure

# weak references in both directions: all are deleted with the last block that has the first structure
_DERIVED: "WeakKeyDictionary[Structure, list[Structure]]" = WeakKeyDictionary()


def derived(structure: Structure, **changes: Any) -> Structure:
    """The structure with changed fields; the structure itself if nothing differs."""
    if _has(structure, changes):
        return structure
    known = _DERIVED.setdefault(structure, [])
    for k, other in enumerate(known):
        rest = {field.name: getattr(structure, field.name) for field in dataclasses.fields(structure)} | changes
        if _has(other, rest):
            known.insert(0, known.pop(k))
            return other
    new = dataclasses.replace(structure, **changes)
    known.insert(0, new)
    del known[REMEMBERED:]
    return new


def _has(structure: Structure, fields: dict[str, Any]) -> bool:
    return all(_equal(getattr(structure, name), value) for name, value in fields.items())


def _equal(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return type(one) is type(other) and one == other
