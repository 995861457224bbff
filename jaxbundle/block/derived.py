"""Structures that are made of others: the same change of the same structure is the same object.

Compiled programs and plans are found again by the identity of a structure. So one that is derived anew for every
adjustment, as by the choice of a datum, must not be a new one every time.
"""

import dataclasses
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from jaxbundle.block.block import Structure

REMEMBERED = 4  # changes of one structure

# a structure does not know those derived from it, nor they it: all go when the last block that has the first one goes
_DERIVED: "WeakKeyDictionary[Structure, list[Structure]]" = WeakKeyDictionary()


def derived(structure: Structure, **changes: Any) -> Structure:
    """The structure with some fields changed; itself where they are what it has."""
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
