"""Approximate values of the unknowns: from one image, from two, from a whole block; and their check.

    one photograph      three_points, resection, direct_linear_transformation, planar_resection
    two photographs     five_points, two_images, pair_search, coplanarity, relative_orientation
    one model           absolute_orientation
    a whole block       from_nothing chooses the way: oriented (resection of many images), or global_start:
                        common_rays -> block_pairs (minimal_samples, pair_kernel) -> rotation_average -> ray_votes
                        -> linear_positions -> robust_intersection -> anchors, to_object
    values given        start: absurd ones are replaced

The room has the name of its main function, so it can be called as that: `jaxbundle.approximate(block)`.
"""

import importlib
import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    """The module of this folder; Python binds it to `jaxbundle.approximate` when anything here is imported."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return importlib.import_module("jaxbundle.approximate.from_nothing").approximate(*args, **kwargs)


sys.modules[__name__].__class__ = _Room
